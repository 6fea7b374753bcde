"""Motion masks: what moves relative to the static scene."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from decomotion.data.masks import evidence, labelling
from decomotion.data.pool import Positions, first_points
from decomotion.data.sampling import bilinear
from decomotion.frames import AnyFrames
from decomotion.units import to_units

Mask = npt.NDArray[np.bool_]


def auto_masks(
    frames: AnyFrames,
    points: npt.NDArray[np.float32],
    targets: Positions,
    confidence: npt.NDArray[np.uint8],
    grid: tuple[int, int],
    random: np.random.Generator,
    progress: bool = False,
) -> Mask:
    """What moves relative to the static scene, [frame, H, W], from the geometry of many pairs of frames.

    Args:
        frames: [frame, H, W, 3].
        points: [frame, point, 2] in pixels, of which the first form a jittered grid; the others are not looked at.
        targets: [frame, frame, point, 2] and
        confidence: [frame, frame, point], as in the pool.
        grid: rows and columns.
        random: draws the points that geometry is fitted to.
        progress: show a progress bar.
    """
    height, width = frames.shape[1:3]
    count = grid[0] * grid[1]
    images, positions = evidence.in_units(frames), to_units(points[:, :count], height, width)
    linked = first_points(targets, count), confidence[:, :, :count]
    found = evidence.motion_evidence(images, positions, *linked, (height, width), random, progress)
    lab = np.stack([_lab_at(image, xy) for image, xy in zip(images, positions, strict=True)])
    links = labelling.LinkReader(*linked, grid, height, width)
    probability = labelling.moving_probability(found, lab, links, grid)
    return np.stack([cv2.resize(values.reshape(grid), (width, height)) > 0.5 for values in probability])


def _lab_at(image: npt.NDArray[np.uint8], xy: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """CIE Lab colours [point, 3] of a slightly blurred RGB image at `xy` [point, 2]."""
    lab = cv2.cvtColor(cv2.GaussianBlur(image, (3, 3), 0), cv2.COLOR_RGB2LAB)
    return bilinear(lab, xy).astype(np.float32)

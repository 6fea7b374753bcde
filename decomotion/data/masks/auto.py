"""Motion masks: what moves relative to the static scene, as a probability at each point."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from decomotion.data.masks import labelling
from decomotion.data.masks.consistency import consistent_evidence
from decomotion.data.masks.evidence import in_units
from decomotion.data.masks.links import Links
from decomotion.data.positions import Positions
from decomotion.data.sampling import bilinear, rescaled
from decomotion.frames import AnyFrames

Mask = npt.NDArray[np.bool_]
Floats = npt.NDArray[np.float32]

MOVES = 0.5
"""What is likelier than this to move is taken to do so."""


def moving_probability(
    frames: AnyFrames,
    points: npt.NDArray[np.float32],
    targets: Positions,
    confidence: npt.NDArray[np.uint8],
    grid: tuple[int, int],
    sides: tuple[int, int],
    random: np.random.Generator,
    progress: bool = False,
) -> Floats:
    """How likely each point of the grid moves relative to the static scene, [frame, row, column], from many pairs.

    Args:
        frames: [frame, h, w, 3], the clip's at any size.
        points: [frame, point, 2] in pixels of the clip, of which the first form a jittered grid; others are not
            looked at.
        targets: [frame, frame, point, 2] and
        confidence: [frame, frame, point], as in the pool.
        grid: rows and columns.
        sides: height and width of the clip.
        random: draws the points that geometry is fitted to.
        progress: show a progress bar.
    """
    links = Links(points, targets, confidence, grid, sides)
    found = consistent_evidence(frames, links, random, progress)
    lab = np.stack([_lab_at(in_units(frame), xy) for frame, xy in zip(frames, links.points, strict=True)])
    return labelling.moving_probability(found, lab, links).reshape(-1, *grid)


def moves_at(probability: Floats, xy: Floats, sides: tuple[int, int]) -> Mask:
    """Whether what lies at `xy` [point, 2], in pixels of a clip of those sides, moves, by one frame's [row, column]."""
    return bilinear(probability, rescaled(xy, sides, probability.shape[:2]))[:, 0] > MOVES


def rendered(probability: Floats, sides: tuple[int, int]) -> Mask:
    """The masks [frame, H, W] of [frame, row, column], to look at and to compare."""
    height, width = sides
    return np.stack([cv2.resize(values, (width, height)) > MOVES for values in probability])


def _lab_at(image: npt.NDArray[np.uint8], xy: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """CIE Lab colours [point, 3] of a slightly blurred RGB image at `xy` [point, 2]."""
    lab = cv2.cvtColor(cv2.GaussianBlur(image, (3, 3), 0), cv2.COLOR_RGB2LAB)
    return bilinear(lab, xy).astype(np.float32)

"""Motion masks: what moves relative to the static scene."""

from __future__ import annotations

import logging
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from decomotion.clip import images_in
from decomotion.data import evidence, labelling
from decomotion.data.pool import Positions, first_points
from decomotion.data.sampling import bilinear
from decomotion.errors import SupervisionError

log = logging.getLogger(__name__)

Mask = npt.NDArray[np.bool_]

JPEG_BLACK = 127
"""A JPEG's edges ring: what is not brighter than this is black."""


def auto_masks(
    frames: npt.NDArray[np.uint8],
    points: npt.NDArray[np.float32],
    targets: Positions,
    confidence: npt.NDArray[np.uint8],
    grid: tuple[int, int],
    progress: bool = False,
) -> Mask:
    """What moves relative to the static scene, [frame, H, W], from the geometry of many pairs of frames.

    Args:
        frames: [frame, H, W, 3].
        points: [frame, point, 2] in pixels, of which the first form a jittered grid; the others are not looked at.
        targets: [frame, frame, point, 2] and
        confidence: [frame, frame, point], as in the pool.
        grid: rows and columns.
        progress: show a progress bar.
    """
    height, width = frames.shape[1:3]
    count = grid[0] * grid[1]
    images, positions = evidence.in_units(frames), evidence.to_units(points[:, :count], height, width)
    scale = 256 / max(height, width)
    links = first_points(targets, count), confidence[:, :, :count]
    found = evidence.motion_evidence(images, positions, *links, scale, progress)
    return labelled_masks(images, (height, width), found, points, targets, confidence, grid)


def labelled_masks(
    images: npt.NDArray[np.uint8],
    size: tuple[int, int],
    found: evidence.Evidence,
    points: npt.NDArray[np.float32],
    targets: Positions,
    confidence: npt.NDArray[np.uint8],
    grid: tuple[int, int],
) -> Mask:
    """Masks [frame, H, W] from the evidence found at the points of the grid.

    `images` are those of `evidence.in_units`, `size` is the clip's (H, W); the rest as for `auto_masks`.
    """
    height, width = size
    count = grid[0] * grid[1]
    positions = evidence.to_units(points[:, :count], height, width)
    lab = np.stack([_lab_at(image, xy) for image, xy in zip(images, positions, strict=True)])
    links = labelling.Links(first_points(targets, count), confidence[:, :, :count], grid, height, width)
    probability = labelling.moving_probability(found, lab, links, grid)
    return np.stack([cv2.resize(values.reshape(grid), (width, height)) > 0.5 for values in probability])


def _lab_at(image: npt.NDArray[np.uint8], xy: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """CIE Lab colours [point, 3] of a slightly blurred RGB image at `xy` [point, 2]."""
    lab = cv2.cvtColor(cv2.GaussianBlur(image, (3, 3), 0), cv2.COLOR_RGB2LAB)
    return bilinear(lab, xy).astype(np.float32)


def read_masks(folder: Path, frames: int, height: int, width: int) -> Mask:
    """Masks [frame, H, W] from a folder of images, one a frame in natural order; any pixel that is not black moves.

    Raises `SupervisionError` where they do not fit the clip.
    """
    if not folder.is_dir():
        raise SupervisionError(f"mask folder {folder} does not exist; give a folder of images, 'auto' or 'none'")
    files = images_in(folder)
    if len(files) != frames:
        raise SupervisionError(f"mask folder {folder} has {len(files)} images but the clip has {frames} frames")
    masks = []
    for file in files:
        encoded = np.fromfile(file, np.uint8) if file.is_file() else np.empty(0, np.uint8)
        image = cv2.imdecode(encoded, cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH) if encoded.size else None
        if image is None:
            raise SupervisionError(f"mask {file} does not decode as an image; replace it")
        mask = image.max(axis=-1) > (0 if file.suffix.lower() == ".png" else JPEG_BLACK)
        if mask.shape != (height, width):
            raise SupervisionError(
                f"mask {file} is {mask.shape[1]}x{mask.shape[0]} but the clip is {width}x{height}; resize it"
            )
        masks.append(mask)
    if not any(mask.any() for mask in masks):
        log.warning("all masks in %s are black: nothing moves", folder)
    return np.stack(masks)

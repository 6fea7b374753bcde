"""Motion masks: what moves relative to the static scene."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from decomotion.clip import images_in
from decomotion.data import evidence, labelling
from decomotion.data.pool import Positions, first_points
from decomotion.errors import SupervisionError

Mask = npt.NDArray[np.bool_]


def auto_masks(
    frames: npt.NDArray[np.uint8],
    points: npt.NDArray[np.float32],
    targets: Positions,
    confidence: npt.NDArray[np.uint8],
    grid: tuple[int, int],
) -> Mask:
    """What moves relative to the static scene, [frame, H, W], from the geometry of many pairs of frames.

    Args:
        frames: [frame, H, W, 3].
        points: [frame, point, 2] in pixels, of which the first form a jittered grid; the others are not looked at.
        targets: [frame, frame, point, 2] and
        confidence: [frame, frame, point], as in the pool.
        grid: rows and columns.
    """
    height, width = frames.shape[1:3]
    count = grid[0] * grid[1]
    positions = evidence.to_units(points[:, :count], height, width)
    scale = 256 / max(height, width)
    found = evidence.motion_evidence(
        evidence.in_units(frames), positions, first_points(targets, count), confidence[:, :, :count], scale
    )
    return labelled_masks(frames, found, points, targets, confidence, grid)


def labelled_masks(
    frames: npt.NDArray[np.uint8],
    found: evidence.Evidence,
    points: npt.NDArray[np.float32],
    targets: Positions,
    confidence: npt.NDArray[np.uint8],
    grid: tuple[int, int],
) -> Mask:
    """Masks [frame, H, W] from the evidence found at the points of the grid; the rest as for `auto_masks`."""
    height, width = frames.shape[1:3]
    count = grid[0] * grid[1]
    positions = evidence.to_units(points[:, :count], height, width)
    lab = np.stack([_lab_at(image, xy) for image, xy in zip(evidence.in_units(frames), positions, strict=True)])
    links = labelling.Links(first_points(targets, count), confidence[:, :, :count], grid, height, width)
    probability = labelling.moving_probability(found, lab, links, grid)
    enlarged = [cv2.resize(values.reshape(grid), (width, height)) for values in probability]
    return np.stack(enlarged) > 0.5


def _lab_at(image: npt.NDArray[np.uint8], xy: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """CIE Lab colours [point, 3] of a slightly blurred RGB image at `xy` [point, 2]."""
    lab = cv2.cvtColor(cv2.GaussianBlur(image, (3, 3), 0), cv2.COLOR_RGB2LAB)
    return cv2.remap(lab, xy[None], None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[0].astype(np.float32)  # type: ignore[call-overload]


def read_masks(folder: Path, frames: int, height: int, width: int) -> Mask:
    """Masks [frame, H, W] from a folder of images, one a frame in natural order; any non-black pixel moves.

    Raises `SupervisionError` where they do not fit the clip.
    """
    if not folder.is_dir():
        raise SupervisionError(f"mask folder {folder} does not exist; give a folder of images, 'auto' or 'none'")
    files = images_in(folder)
    if len(files) != frames:
        raise SupervisionError(f"mask folder {folder} has {len(files)} images but the clip has {frames} frames")
    masks = []
    for file in files:
        image = cv2.imread(str(file), cv2.IMREAD_COLOR)
        if image is None:
            raise SupervisionError(f"mask {file} does not decode as an image; replace it")
        mask = image.max(axis=-1) > 0
        if mask.shape != (height, width):
            raise SupervisionError(
                f"mask {file} is {mask.shape[1]}x{mask.shape[0]} but the clip is {width}x{height}; resize it"
            )
        masks.append(mask)
    return np.stack(masks)

"""Motion masks: what moves relative to the static scene."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from decomotion.clip import images_in
from decomotion.data import evidence, labelling
from decomotion.data.pool import Positions
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
        points: [frame, point, 2], a jittered grid in pixels.
        targets: [frame, frame, point, 2] and
        confidence: [frame, frame, point], as in the pool.
        grid: rows and columns of `points`.
    """
    height, width = frames.shape[1:3]
    images = evidence.in_units(frames)
    positions = evidence.to_units(points, height, width)
    found = evidence.motion_evidence(images, positions, targets, confidence, 256 / max(height, width))
    lab = np.stack([_lab_at(image, xy) for image, xy in zip(images, positions, strict=True)])
    links = labelling.Links(targets, confidence, grid, height, width)
    probability = labelling.moving_probability(found, lab, links, grid)
    return np.stack([_enlarged(values, grid, height, width) > 0.5 for values in probability])


def _lab_at(image: npt.NDArray[np.uint8], xy: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """CIE Lab colours [point, 3] of a slightly blurred RGB image at `xy` [point, 2]."""
    lab = cv2.cvtColor(cv2.GaussianBlur(image, (3, 3), 0), cv2.COLOR_RGB2LAB)
    return cv2.remap(lab, xy[None], None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[0].astype(np.float32)  # type: ignore[call-overload]


def _enlarged(
    values: npt.NDArray[np.float32], grid: tuple[int, int], height: int, width: int
) -> npt.NDArray[np.float32]:
    return cv2.resize(values.reshape(grid).astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR)


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

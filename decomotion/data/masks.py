"""Motion masks: what moves relative to the static scene."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from decomotion.clip import images_in
from decomotion.data.pool import Positions
from decomotion.errors import SupervisionError

Mask = npt.NDArray[np.bool_]

NEIGHBOURS = 8
"""Residuals are accumulated over target frames up to this far away."""
MIN_VALID = 64
"""A pair with fewer visible correspondences says nothing."""
HOMOGRAPHY_UNITS = 1.5
"""Inliers of the camera's homography lie this near, in pixels of a frame whose longer side is 256."""
RESIDUAL_UNITS = 1.0
"""Residual at a gap of one frame, in pixels of a 256-pixel frame, from which a point counts as moving."""


def residual_motion(
    points: npt.NDArray[np.float32], targets: Positions, confidence: npt.NDArray[np.uint8], unit: float
) -> npt.NDArray[np.float32]:
    """How much each point's motion differs from the camera's, [frame, point], pixels per square root of the gap.

    For each pair of frames within `NEIGHBOURS` a homography is fitted robustly; a point's value is the median over
    the pairs in which it is visible of its distance to where the homography leads. 0 where it is visible in none.
    `unit` is the length in pixels of one unit: a 256th of the frame's longer side.
    """
    frames = len(points)
    result = np.zeros(points.shape[:2], np.float32)
    for frame in range(frames):
        residuals = []
        for other in range(max(0, frame - NEIGHBOURS), min(frames, frame + NEIGHBOURS + 1)):
            visible = confidence[frame, other] > 0
            if other == frame or visible.sum() < MIN_VALID:
                continue
            source, target = points[frame], targets[frame, other]
            matrix, _ = cv2.findHomography(source[visible], target[visible], cv2.RANSAC, HOMOGRAPHY_UNITS * unit)
            if matrix is None:
                continue
            led = cv2.perspectiveTransform(source[None], matrix)[0]
            distance = np.linalg.norm(led - target, axis=-1) / abs(other - frame) ** 0.5
            residuals.append(np.where(visible, distance, np.nan))
        if residuals:
            stacked = np.stack(residuals)
            seen = ~np.isnan(stacked).all(axis=0)
            result[frame, seen] = np.nanmedian(stacked[:, seen], axis=0)
    return result


def moving_from_residual(residual: npt.NDArray[np.float32], grid: tuple[int, int], height: int, width: int) -> Mask:
    """Masks [frame, H, W] from the residuals of a jittered grid of points, [frame, rows * columns]."""
    threshold = RESIDUAL_UNITS * max(height, width) / 256
    masks = []
    for values in residual.reshape(-1, *grid):
        smooth = cv2.medianBlur(values.astype(np.float32), 5)
        image = cv2.resize(smooth, (width, height), interpolation=cv2.INTER_LINEAR)
        mask = (image > threshold).astype(np.uint8)
        radius = max(1, round(max(height, width) / 128))
        kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
        mask = cv2.morphologyEx(cv2.morphologyEx(mask, cv2.MORPH_OPEN, kernel), cv2.MORPH_CLOSE, kernel)
        masks.append(mask > 0)
    return np.stack(masks)


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

"""Closed-form motion: robust affine fits between neighbouring frames, chained over the clip."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from decomotion.data.pool import Positions

RANSAC_UNITS = 1.0
"""Inliers of an affine fit lie this near, in pixels of a frame whose longer side is 256."""
MIN_POINTS = 12

Affine = npt.NDArray[np.float64]


def fit_affine(
    source: npt.NDArray[np.float32], target: npt.NDArray[np.float32], unit: float, similarity: bool = False
) -> Affine | None:
    """Robust 2x3 affine map from `source` to `target`, both [point, 2]; a shift where points are few, None without any.

    `unit` is the length in pixels of one unit: a 256th of the frame's longer side.
    """
    if len(source) >= MIN_POINTS:
        estimate = cv2.estimateAffinePartial2D if similarity else cv2.estimateAffine2D
        matrix, _ = estimate(source, target, method=cv2.RANSAC, ransacReprojThreshold=RANSAC_UNITS * unit)
        if matrix is not None:
            return matrix.astype(np.float64)
    if not len(source):
        return None
    shift = np.median(target - source, axis=0)
    return np.array([[1, 0, shift[0]], [0, 1, shift[1]]], np.float64)


def compose(outer: Affine, inner: Affine) -> Affine:
    """The map that applies `inner` first."""
    return (homogeneous(outer) @ homogeneous(inner))[:2]


def invert(matrix: Affine) -> Affine:
    """The inverse of a 2x3 affine map."""
    return np.linalg.inv(homogeneous(matrix))[:2].astype(np.float64)


def homogeneous(matrix: Affine) -> Affine:
    """2x3 to 3x3."""
    return np.vstack([matrix, [0, 0, 1]])


def chain(
    points: npt.NDArray[np.float32],
    targets: Positions,
    confidence: npt.NDArray[np.uint8],
    counted: npt.NDArray[np.bool_],
    unit: float,
    similarity: bool = False,
    fallback: Affine | None = None,
) -> Affine:
    """Affine maps from every frame to the middle frame, in pixels: [frame, 2, 3].

    Args:
        points: [frame, point, 2].
        targets: [frame, frame, point, 2], as in the pool.
        confidence: [frame, frame, point], as in the pool; 0: not to be fitted to.
        counted: [frame, point], the points to fit to.
        unit: pixels of one unit, as in `fit_affine`.
        similarity: fit rotation, scale and shift only.
        fallback: [frame, 2, 3], maps to the middle frame to follow between frames that share no usable points;
            default: stand still.
    """
    frames = len(points)
    middle = frames // 2
    maps = np.tile(np.eye(2, 3), (frames, 1, 1))
    for step in (1, -1):
        for frame in range(middle + step, frames if step > 0 else -1, step):
            previous = frame - step
            use = (confidence[frame, previous] > 0) & counted[frame]
            to_previous = fit_affine(points[frame][use], targets[frame, previous][use], unit, similarity)
            if to_previous is None and fallback is not None:
                to_previous = compose(invert(fallback[previous]), fallback[frame])
            if to_previous is None:
                to_previous = np.eye(2, 3)
            maps[frame] = compose(maps[previous], to_previous)
    return maps


def to_normalised(maps: Affine, height: int, width: int) -> npt.NDArray[np.float32]:
    """Affine maps in pixels, [frame, 2, 3], rewritten for normalised coordinates (`decomotion.geometry`)."""
    scale = 2 / max(height, width)
    normalise = np.array([[scale, 0, -(width - 1) / 2 * scale], [0, scale, -(height - 1) / 2 * scale]])
    pixels = invert(normalise)
    return np.stack([compose(normalise, compose(matrix, pixels)) for matrix in maps]).astype(np.float32)

"""Closed-form motion: robust affine fits between neighbouring frames, chained over the clip."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

RANSAC_PIXELS = 1.0
MIN_POINTS = 12

Affine = npt.NDArray[np.float64]


def fit_affine(source: npt.NDArray[np.float32], target: npt.NDArray[np.float32], similarity: bool = False) -> Affine:
    """Robust 2x3 affine map from `source` to `target`, both [point, 2]; a translation where points are few."""
    if len(source) >= MIN_POINTS:
        estimate = cv2.estimateAffinePartial2D if similarity else cv2.estimateAffine2D
        matrix, _ = estimate(source, target, method=cv2.RANSAC, ransacReprojThreshold=RANSAC_PIXELS, maxIters=2000)
        if matrix is not None:
            return matrix.astype(np.float64)
    shift = np.median(target - source, axis=0) if len(source) else np.zeros(2)
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
    targets: npt.NDArray[np.float32],
    usable: npt.NDArray[np.bool_],
    similarity: bool = False,
) -> Affine:
    """Affine maps from every frame to the middle frame, in pixels: [frame, 2, 3].

    Args:
        points: [frame, point, 2].
        targets: [frame, frame, point, 2], as in the pool.
        usable: [frame, frame, point], the correspondences to fit to.
        similarity: fit rotation, scale and shift only.
    """
    frames = len(points)
    middle = frames // 2
    maps = np.tile(np.eye(2, 3), (frames, 1, 1))
    for step in (1, -1):
        for frame in range(middle + step, frames if step > 0 else -1, step):
            previous = frame - step
            use = usable[frame, previous]
            to_previous = fit_affine(points[frame][use], targets[frame, previous][use], similarity)
            maps[frame] = compose(maps[previous], to_previous)
    return maps


def to_normalised(maps: Affine, height: int, width: int) -> npt.NDArray[np.float32]:
    """Affine maps in pixels, [frame, 2, 3], rewritten for normalised coordinates (`decomotion.geometry`)."""
    scale = 2 / max(height, width)
    normalise = np.array([[scale, 0, -(width - 1) / 2 * scale], [0, scale, -(height - 1) / 2 * scale]])
    pixels = invert(normalise)
    return np.stack([compose(normalise, compose(matrix, pixels)) for matrix in maps]).astype(np.float32)

"""Closed-form motion: robust affine fits between neighbouring frames, chained over the clip."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from decomotion.data.positions import Positions

RANSAC_UNITS = 1.0
"""Inliers of an affine fit lie this near, in pixels of a frame whose longer side is 256."""
MIN_POINTS = 12

REACH = 24
"""Frames that share too few points with those near them are fitted to others up to this far away."""
ENOUGH = 0.01
"""Share of a frame's points that show how the scene moves; what fewer agree on may be something else."""

Affine = npt.NDArray[np.float64]
Points = npt.NDArray[np.float32]


def fit_affine(
    source: Points, target: Points, unit: float, similarity: bool = False, least: int = MIN_POINTS
) -> Affine | None:
    """Robust 2x3 affine map from `source` to `target`, both [point, 2]; None where fewer than `least` points follow it.

    `unit` is the length in pixels of one unit: a 256th of the frame's longer side.
    """
    if len(source) < max(least, MIN_POINTS):
        return None
    estimate = cv2.estimateAffinePartial2D if similarity else cv2.estimateAffine2D
    matrix, inliers = estimate(source, target, method=cv2.RANSAC, ransacReprojThreshold=RANSAC_UNITS * unit)
    return None if matrix is None or inliers.sum() < least else matrix.astype(np.float64)


def shift(source: Points, target: Points) -> Affine | None:
    """The median shift from `source` to `target`, both [point, 2], as a 2x3 map; None without points."""
    if not len(source):
        return None
    x, y = np.median(target - source, axis=0)
    return np.array([[1, 0, x], [0, 1, y]], np.float64)


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
    points: Points,
    targets: Positions,
    confidence: npt.NDArray[np.uint8],
    counted: npt.NDArray[np.bool_],
    unit: float,
    similarity: bool = False,
    fallback: Affine | None = None,
) -> Affine:
    """Affine maps from every frame to the middle frame, in pixels: [frame, 2, 3].

    Each frame is fitted to the nearest that has its map and shares enough points with it, from the middle to the ends.
    Frames that share too few are interpolated, and stand still where the clip ends before the next that does.

    Args:
        points: [frame, point, 2].
        targets: [frame, frame, point, 2], as in the pool.
        confidence: [frame, frame, point], as in the pool; 0: not to be fitted to.
        counted: [frame, point], the points to fit to.
        unit: pixels of one unit, as in `fit_affine`.
        similarity: fit rotation, scale and shift only.
        fallback: [frame, 2, 3], maps to the middle frame to follow, in place of standing still, between frames that
            share too few points; what follows it may be small: any points are enough.
    """
    frames, middle = len(points), len(points) // 2
    least = MIN_POINTS if fallback is not None else max(MIN_POINTS, round(ENOUGH * points.shape[1]))

    def fitted(frame: int, other: int) -> Affine | None:
        use = (confidence[frame, other] > 0) & counted[frame]
        source, target = points[frame][use], targets[frame, other][use]
        found = fit_affine(source, target, unit, similarity, least)
        return shift(source, target) if found is None and fallback is not None and abs(other - frame) == 1 else found

    outward = sorted(range(frames), key=lambda frame: abs(frame - middle))
    beside = ((frame, other) for frame in outward for other in (frame - 1, frame + 1) if 0 <= other < frames)
    first = next((frame for frame, other in beside if fitted(frame, other) is not None), middle)
    maps: dict[int, Affine] = {first: np.eye(2, 3)}
    for frame in sorted(range(frames), key=lambda frame: abs(frame - first)):
        near = (other for other in sorted(maps, key=lambda other: abs(other - frame)) if abs(other - frame) <= REACH)
        found = ((other, fitted(frame, other)) for other in near if frame not in maps)
        for other, to_other in found:
            if to_other is not None:
                maps[frame] = compose(maps[other], to_other)
                break
    followed = np.tile(np.eye(2, 3), (frames, 1, 1)) if fallback is None else fallback
    placed = sorted(maps)
    apart = np.stack([compose(maps[frame], invert(followed[frame])) for frame in placed]).reshape(len(placed), 6)
    between = np.stack([np.interp(np.arange(frames), placed, each) for each in apart.T], axis=1).reshape(frames, 2, 3)
    whole = [maps.get(frame, compose(between[frame], followed[frame])) for frame in range(frames)]
    to_middle = invert(whole[middle])
    return np.stack([compose(to_middle, matrix) for matrix in whole])


def to_normalised(maps: Affine, height: int, width: int) -> npt.NDArray[np.float32]:
    """Affine maps in pixels, [frame, 2, 3], rewritten for normalised coordinates (`decomotion.geometry`)."""
    scale = 2 / max(height, width)
    normalise = np.array([[scale, 0, -(width - 1) / 2 * scale], [0, scale, -(height - 1) / 2 * scale]])
    pixels = invert(normalise)
    return np.stack([compose(normalise, compose(matrix, pixels)) for matrix in maps]).astype(np.float32)

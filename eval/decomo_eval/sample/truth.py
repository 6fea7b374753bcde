"""Ground truth: points fixed to the scene's layers, where they go, and when they are hidden."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from decomo_eval.sample.scene import BACKGROUND, Scene

BACKGROUND_POINTS = 36
OBJECT_POINTS = 20
CLEARANCE = 2
"""Pixels around a chosen pixel that show the same layer, since a point within a pixel of an outline is ambiguous."""


@dataclass(frozen=True)
class Truth:
    """Tracks of points of known material."""

    points: npt.NDArray[np.float64]
    """[N, T, 2], (x, y) in fractions of the raster, exact also where hidden."""
    occluded: npt.NDArray[np.bool_]
    """[N, T], True where another layer is in front or the point is outside the frame."""
    layer: npt.NDArray[np.int64]
    """[N], the layer a point belongs to."""


def follow_points(
    scene: Scene, times: npt.NDArray[np.float64], layer_maps: npt.NDArray[np.int64], rng: np.random.Generator
) -> Truth:
    """Chooses points visible at some frame, a quota for each layer, and follows them over all `times` [T].

    `layer_maps` [T, H, W] are the frontmost layers at those times. A layer never seen gets no points.
    """
    points, occluded, owners = [], [], []
    for index, layer in enumerate(scene.layers):
        seeds = _choose(layer_maps == index, BACKGROUND_POINTS if index == BACKGROUND else OBJECT_POINTS, rng)
        if not seeds:
            continue
        uv = np.array([layer.warp(times[frame]).to_material(xy) for frame, xy in seeds])
        xy = np.stack([layer.warp(time).to_frame(uv) for time in times], axis=1)
        front = np.stack([scene.layer_at(xy[:, frame], time) for frame, time in enumerate(times)], axis=1)
        outside = ((xy < 0) | (xy >= 1)).any(axis=-1)
        points.append(xy)
        occluded.append(outside | (front != index))
        owners.append(np.full(len(uv), index))
    return Truth(np.concatenate(points), np.concatenate(occluded), np.concatenate(owners))


def _choose(
    shown: npt.NDArray[np.bool_], count: int, rng: np.random.Generator
) -> list[tuple[int, npt.NDArray[np.float64]]]:
    """Up to `count` places (frame, position [2]) well inside a layer's visible part `shown` [T, H, W]."""
    neighbourhood = np.ones((2 * CLEARANCE + 1, 2 * CLEARANCE + 1), np.uint8)
    clear = np.stack([cv2.erode(mask.astype(np.uint8), neighbourhood) for mask in shown])
    candidates = np.argwhere(clear)
    chosen = rng.permutation(len(candidates))[:count]
    size = shown.shape[-1]
    return [(int(frame), (np.array([column, row]) + rng.random(2)) / size) for frame, row, column in candidates[chosen]]

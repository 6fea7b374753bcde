"""From a scene to frames: antialiased colours, the map of frontmost layers, and what a camera adds."""

from __future__ import annotations

import math

import cv2
import numpy as np
import numpy.typing as npt

from decomo_eval.sample.scene import REFERENCE_SIZE, Layer, Scene
from decomo_eval.sample.texture import Image

BLUR = 0.45
"""Deviation of the lens's blur, pixels."""
NOISE = 2.0 / 255
"""Deviation of the sensor's noise."""
FLICKER = 0.05
"""How much the light swings."""
VIGNETTE = 0.15
"""How much darker the corners are."""


def pixel_centres(columns: range, rows: range, size: int) -> npt.NDArray[np.float64]:
    """Frame positions [rows, columns, 2] of the centres of pixels of a `size` x `size` raster."""
    x, y = np.meshgrid((np.array(columns) + 0.5) / size, (np.array(rows) + 0.5) / size)
    return np.stack([x, y], axis=-1)


def render_layers(scene: Scene, time: float, size: int) -> npt.NDArray[np.int64]:
    """Index [size, size] of the frontmost layer at each pixel's centre."""
    return scene.layer_at(pixel_centres(range(size), range(size), size), time)


def render_frame(scene: Scene, time: float, size: int, rows: range | None = None) -> Image:
    """Colours [size, size, 3] in 0..1, before the camera's noise: drawn at least twice as fine, then averaged.

    Of successive `rows` alone [rows, size, 3], where they are given.
    """
    rows = range(size) if rows is None else rows
    fineness = max(2, math.ceil(2 * REFERENCE_SIZE / size))
    fine, fine_rows = fineness * size, range(fineness * rows.start, fineness * rows.stop)
    background, *objects = scene.layers
    canvas = background.texture.at(background.warp(time).to_material(pixel_centres(range(fine), fine_rows, fine)))
    for layer in objects:
        _paint(canvas, layer, time, fine_rows)
    return cv2.resize(canvas, (size, len(rows)), interpolation=cv2.INTER_AREA).astype(np.float32, copy=False)


def _paint(canvas: Image, layer: Layer, time: float, rows: range) -> None:
    """Lays `layer` over the canvas, these rows of a square, in place, with an edge one canvas pixel soft."""
    outline, warp, size = layer.body.outline, layer.warp(time), canvas.shape[1]
    assert outline is not None
    corners = warp.to_frame(outline.polygon()) * size
    left, top = np.clip(np.floor(corners.min(axis=0)).astype(int) - 2, (0, rows.start), (size, rows.stop))
    right, bottom = np.clip(np.ceil(corners.max(axis=0)).astype(int) + 2, (0, rows.start), (size, rows.stop))
    if left >= right or top >= bottom:
        return
    uv = warp.to_material(pixel_centres(range(left, right), range(top, bottom), size))
    distance = outline.distance(uv) * math.sqrt(abs(np.linalg.det(warp.matrix))) * size
    alpha = np.clip(0.5 - distance, 0, 1).astype(np.float32)[..., None]
    below = canvas[top - rows.start : bottom - rows.start, left:right]
    below += alpha * (layer.texture.at(uv) - below)


def photograph(frame: Image, time: float, phase: float, rng: np.random.Generator) -> npt.NDArray[np.uint8]:
    """What a camera makes of a rendered frame: changing light, darker corners, a slight blur, noise, 8 bits.

    A frame that is wider than high is the middle of a square.
    """
    height, width = frame.shape[:2]
    first = (width - height) // 2
    offset = pixel_centres(range(width), range(first, first + height), width) - 0.5
    light = 1 + FLICKER * math.sin(2 * math.pi * (time + phase))
    exposure = light * (1 - VIGNETTE * 2 * (offset**2).sum(axis=-1, keepdims=True))
    blurred = cv2.GaussianBlur(frame * exposure.astype(np.float32), (0, 0), BLUR)
    noisy = blurred + NOISE * rng.standard_normal(frame.shape, np.float32)
    return np.clip(np.round(noisy * 255), 0, 255).astype(np.uint8)

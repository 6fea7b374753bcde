"""Clips of flat textured layers that move by known maps, with links that know what hides what.

Positions are (x, y) in pixels, pixel centres at integers. The first layer is the scene, without an edge; each further
one is a rectangle that hides those before it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from decomotion.data.pool import grid_shape, jittered_grid

Map = npt.NDArray[np.float64]
"""[2, 3], from a layer to a frame."""


@dataclass(frozen=True)
class Layer:
    """A texture and where it is in each frame."""

    at: Callable[[int], Map]
    sides: tuple[float, float] | None = None
    """Height and width of the rectangle about the layer's origin; None: without end."""

    def holds(self, xy: npt.NDArray[np.floating]) -> npt.NDArray[np.bool_]:
        """Whether it covers places [..., 2] of its own plane."""
        if self.sides is None:
            return np.ones(xy.shape[:-1], np.bool_)
        return np.asarray((np.abs(xy) <= np.array(self.sides[::-1]) / 2).all(axis=-1), np.bool_)


@dataclass(frozen=True)
class Layered:
    """A clip with what is true of it."""

    frames: npt.NDArray[np.uint8]
    points: npt.NDArray[np.float32]
    targets: npt.NDArray[np.float32]
    confidence: npt.NDArray[np.uint8]
    grid: tuple[int, int]
    owner: npt.NDArray[np.int64]
    """[frame, point], the layer that each point lies on."""

    @property
    def sides(self) -> tuple[int, int]:
        """Height and width."""
        return self.frames.shape[1], self.frames.shape[2]


def placed(x: float, y: float, scale: float = 1.0, turn: float = 0.0) -> Map:
    """A layer's origin at (x, y), so much larger and turned by so many radians."""
    c, s = scale * np.cos(turn), scale * np.sin(turn)
    return np.array([[c, -s, x], [s, c, y]])


def through(matrix: Map, xy: npt.NDArray[np.floating]) -> npt.NDArray[np.float64]:
    """Places [..., 2] carried by a map."""
    return np.asarray(xy @ matrix[:, :2].T + matrix[:, 2], np.float64)


def filmed(
    layers: list[Layer], count: int, height: int = 72, width: int = 104, points: int = 1500, noise: float = 0.1
) -> Layered:
    """`count` frames of the layers; links err by `noise` pixels, and are hidden where another layer is before them."""
    random = np.random.default_rng(0)
    maps = np.array([[layer.at(frame) for layer in layers] for frame in range(count)])
    back = np.array([[cv2.invertAffineTransform(matrix) for matrix in each] for each in maps])
    where = jittered_grid(count, height, width, points, random)
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).astype(float)

    def foremost(xy: npt.NDArray[np.floating], frame: int) -> npt.NDArray[np.int64]:
        covered = [layer.holds(through(back[frame, k], xy)) for k, layer in enumerate(layers)]
        return np.asarray(len(layers) - 1 - np.argmax(covered[::-1], axis=0), np.int64)

    side = 512
    textures = [cv2.GaussianBlur(random.normal(size=(side, side, 3)), (0, 0), 1.5) * 200 + 128 for _ in layers]
    frames = np.empty((count, height, width, 3))
    owner = np.stack([foremost(xy, frame) for frame, xy in enumerate(where)])
    targets = np.empty((count, *where.shape), np.float64).swapaxes(0, 1)
    confidence = np.zeros(targets.shape[:3], np.uint8)
    for i in range(count):
        drawn = foremost(pixels, i)
        for k, texture in enumerate(textures):
            xy = (through(back[i, k], pixels) + side / 2).astype(np.float32)
            shown = cv2.remap(texture, xy, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)  # type: ignore[call-overload]
            frames[i][drawn == k] = shown[drawn == k]
        for j in range(count):
            for k in range(len(layers)):
                on = owner[i] == k
                targets[i, j, on] = through(maps[j, k], through(back[i, k], where[i, on]))
            x, y = targets[i, j].T
            inside = (x > -0.5) & (y > -0.5) & (x < width - 0.5) & (y < height - 0.5)
            confidence[i, j] = 255 * (inside & (foremost(targets[i, j], j) == owner[i]))
    targets += random.normal(scale=noise, size=targets.shape)
    grid = grid_shape(height, width, points)
    return Layered(np.clip(frames, 0, 255).astype(np.uint8), where, targets.astype(np.float32), confidence, grid, owner)

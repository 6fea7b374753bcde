"""A picture with transparency, read between its pixels at any scale without aliasing: a pyramid, each level half as
large as the one before, of colours that are premultiplied.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from decomo_runtime.sampling import sampled

Floats = npt.NDArray[np.float32]
SHARPER = 0.5
"""Levels: as averages, and cubic interpolation of them, blur more than a pixel does."""
_LEAST = 2
"""Pixels of the shorter side of the coarsest level."""


class Mipmaps:
    """The pyramid of `picture` [h, w, 4], RGBA, uint8, alpha not premultiplied."""

    def __init__(self, picture: npt.NDArray[np.uint8]) -> None:
        level: Floats = (picture / 255).astype(np.float32)
        level[..., :3] *= level[..., 3:]
        self._levels: list[Floats] = [level]
        while min(level.shape[:2]) >= 2 * _LEAST:
            size = (level.shape[1] + 1) // 2, (level.shape[0] + 1) // 2
            level = cv2.resize(level, size, interpolation=cv2.INTER_AREA).astype(np.float32, copy=False)
            self._levels.append(level)

    def read(self, places: Floats, scale: Floats) -> Floats:
        """[N, 4], premultiplied RGBA in [0, 1], at `places` [N, 2]: (x, y) in the picture's pixels, `scale` [N] of
        which lie between neighbouring places. Transparent outside of the picture.
        """
        height, width = self._levels[0].shape[:2]
        inside = ((places >= -0.5) & (places <= np.array([width, height]) - 0.5)).all(axis=1)
        depth = (np.log2(np.maximum(scale, 1)) - SHARPER).clip(0, len(self._levels) - 1)
        read = np.zeros((len(places), 4), np.float32)
        for number, level in enumerate(self._levels):
            weight = (1 - np.abs(depth - number)).clip(0)  # linear between levels
            rows = np.flatnonzero(inside & (weight > 0))
            if len(rows):
                ratio = np.array([level.shape[1] / width, level.shape[0] / height])
                there = ((places[rows] + 0.5) * ratio - 0.5).astype(np.float32)
                read[rows] += weight[rows, None] * sampled(level, there, cv2.INTER_CUBIC)
        read = read.clip(0, 1)  # cubic interpolation overshoots
        read[:, :3] = np.minimum(read[:, :3], read[:, 3:])
        return read

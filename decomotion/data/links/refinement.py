"""Refinement: a match by appearance moved to where the patch around the point itself fits best.

A match says where a cell of four pixels is, to about a pixel; the point wants to know where it is. Lucas and Kanade's
registration of a small patch, started at the match, tells it to a fraction of a pixel, on thin things too, whose cell
lies half on what is behind them.
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt

from decomotion.clip import Clip
from decomotion.data.flow.interface import resized
from decomotion.units import unit

SIDE = 512
"""Longer side of the frames that are compared."""
WINDOW = 17
"""Side of a patch, in their pixels."""
FARTHEST = 2.5
"""What moves farther than this, in pixels of a frame whose longer side is 256, has found something else: not taken."""
KEPT = 64
"""Frames that are kept for the next patches."""
ROUNDS, STEP = 20, 0.01
"""Of the registration at most, and the step in pixels at which it ends."""


class Refiner:
    """Registers patches between any two frames of `clip`."""

    def __init__(self, clip: Clip) -> None:
        scale = SIDE / max(clip.height, clip.width)
        size = (max(1, round(clip.width * scale)), max(1, round(clip.height * scale)))
        self._size = size
        self._grey = lru_cache(KEPT)(lambda frame: cv2.cvtColor(resized(clip.frames[frame], size), cv2.COLOR_RGB2GRAY))

    def __call__(
        self,
        first: int,
        second: int,
        xy: npt.NDArray[np.float32],
        found: npt.NDArray[np.float32],
        raster: tuple[int, ...],
    ) -> npt.NDArray[np.float32]:
        """Where in frame `second` the points [point, 2] are that lie at `xy` in frame `first` and about at `found`.

        Positions are in pixels of a `raster` (height, width) that covers the frames; where a patch is plain, `found`.
        """
        if not len(xy):
            return found
        width, height = self._size
        pixels = np.array([width / raster[1], height / raster[0]], np.float32)
        here, there = ((places + 0.5) * pixels - 0.5 for places in (xy, found))
        moved, registered, _ = cv2.calcOpticalFlowPyrLK(
            self._grey(first),
            self._grey(second),
            here[:, None].astype(np.float32),
            there[:, None].astype(np.float32),
            winSize=(WINDOW, WINDOW),
            maxLevel=0,
            criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, ROUNDS, STEP),
            flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        )
        moved, registered = moved[:, 0], registered[:, 0] > 0
        taken = registered & (np.linalg.norm(moved - there, axis=-1) <= FARTHEST * unit(height, width))
        return np.where(taken[:, None], (moved + 0.5) / pixels - 0.5, found).astype(np.float32)

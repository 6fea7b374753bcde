"""Maps of all pixels of a frame into another one, made fit for moving pictures by them.

A model answers each pixel by itself: a map trembles by fractions of a pixel, and errs in single pixels at outlines. It
is smoothed here, but not across the outlines of what moves differently.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import cv2
import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from decomo_runtime.dense import Dense

Floats = npt.NDArray[np.float32]

SMOOTHED, SIMILAR = 2.0, 1.5
"""Deviations by which a map is smoothed: between places, and between motions, both in pixels."""
RAMP = 0.3
"""Of the score, about the threshold, over which a pixel fades from in sight to hidden."""
_SOFTER = 0.6
"""Pixels, deviation: the rim of what is in sight is as soft as a photograph's."""


@dataclass(frozen=True, eq=False)
class DenseMap:
    """Where each pixel of a frame is in another."""

    places: Floats
    """[H, W, 2], (x, y) in pixels of the clip."""
    visible: Floats
    """[H, W], from 0, hidden there, to 1, in sight."""

    @cached_property
    def scale(self) -> Floats:
        """[H, W]: how many pixels of the other frame lie between neighbouring ones of this one, at most either way.

        Across outlines it is that of the side which changes less.
        """
        across, down = (_derivative(self.places, axis) for axis in (1, 0))
        a, b = across[..., 0], down[..., 0]
        c, d = across[..., 1], down[..., 1]
        scale = (np.hypot(a + d, c - b) + np.hypot(a - d, b + c)) / 2  # the larger singular value
        scale = cv2.medianBlur(scale.astype(np.float32), 5)
        return cv2.blur(scale, (9, 9)).astype(np.float32, copy=False)


def identity(height: int, width: int) -> DenseMap:
    """Of a frame to itself."""
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    return DenseMap(np.stack([x, y], axis=-1), np.ones((height, width), np.float32))


def smoothed(dense: Dense, threshold: float) -> DenseMap:
    """The map of a model's answers; `threshold` is the score above which a pixel is hidden."""
    height, width = dense.occluded.shape
    score = cv2.medianBlur(dense.occlusion, 5)
    visible = ((threshold + RAMP / 2 - score) / RAMP).clip(0, 1)
    visible = cv2.GaussianBlur(visible.astype(np.float32), (0, 0), _SOFTER).astype(np.float32, copy=False)
    flow = np.dstack([dense.flow, np.zeros((height, width), np.float32)])  # OpenCV filters one channel, or three
    flow = cv2.bilateralFilter(cv2.medianBlur(flow, 5), 0, SIMILAR, SMOOTHED)
    return DenseMap(identity(height, width).places + flow[..., :2], visible)


def _derivative(places: Floats, axis: int) -> Floats:
    """[H, W, 2]: of the differences to the pixels before and behind, the shorter one."""
    step = np.diff(places, axis=axis)
    first, last = np.take(step, [0], axis=axis), np.take(step, [-1], axis=axis)
    before, behind = np.concatenate([first, step], axis=axis), np.concatenate([step, last], axis=axis)
    shorter = (before**2).sum(-1) < (behind**2).sum(-1)
    return np.where(shorter[..., None], before, behind)

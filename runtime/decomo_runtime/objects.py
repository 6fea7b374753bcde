"""Which pixels of a clip belong to its moving objects: the rendered motion mask, and what hangs on it.

The mask misses thin and fast parts, a leg or a foot, and knows nothing of shadows. Therefore each frame is compared
with what the frames around it show of the scene in the same place, brought there along the scene's motion: pixels that
differ, lie near the mask and are joined to it by such pixels are counted in.

What is made of a frame is small and held for some frames only, so that memory does not depend on the clip's length.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING

import cv2
import numpy as np
import numpy.typing as npt

from decomo_runtime.contract import HOLE
from decomo_runtime.footage import BESIDE, HELD, Footage, FramesByNumber
from decomo_runtime.layers import look, raster_size
from decomo_runtime.raster import Raster, around, whole
from decomo_runtime.sampling import known_median, sampled
from decomotion.images import filled

if TYPE_CHECKING:
    from decomo_runtime.scene_motion import SceneMotion
    from decomo_runtime.tracker import Tracker

Floats = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

RENDERED_SIDE, COMPARED_SIDE = 128, 256
"""Most pixels of the longer side of the rasters on which the model is rendered, and on which frames are compared."""
STRIDE = 3
"""A frame is compared with those up to `BESIDE` frames away, every so many: the next ones show an object again."""
COVERED = 0.5
"""An object covers a pixel of which it has at least so much, on any raster. A matter of pictures, unlike what it owns
(`Tracker.on_object`): what hangs on a mask is found by comparing frames, and a blurred rim by `GROWN`.
"""
LEAST_VIEWS = 3
"""Frames that must show the scene in a place for a difference to count."""
DIFFERENT, SPREADS = 14.0, 2.0
"""Difference in colour, of 255, beyond all that the scene shows within a pixel and beyond so many times the median
deviation of the frames that show it: clouds drift, leaves move.
"""
REACH = 48.0
"""What hangs on an object lies this near to the mask; this and what follows in pixels of a frame whose longer side is
256."""
_SPARSE = 2
"""Exposure is told by every so many pixels of the raster of comparison, either way."""
_LEAST_COMMON = 64
"""Pixels of that raster that two frames must share for their exposure to be compared."""
GROWN, FEATHER = 3.0, 3.0
"""How far beyond the object nothing of the clip is kept, and the width of the blend into it from there on."""


class Objects:
    """The moving objects of a clip, frame by frame.

    Args:
        tracker: the model.
        frames: the clip: `frames[t]` is uint8 [H, W, 3].
        motion: of the static scene.
    """

    def __init__(self, tracker: Tracker, frames: FramesByNumber, motion: SceneMotion) -> None:
        self._tracker, self._motion = tracker, motion
        longer = max(tracker.height, tracker.width)
        self._full = tracker.height, tracker.width
        self._rendered = raster_size(tracker.facts, min(RENDERED_SIDE, longer))
        self._compared = raster_size(tracker.facts, min(COMPARED_SIDE, longer))
        self._unit = max(self._compared) / 256
        self.frames = Footage(frames, self._full, self._compared)
        """Those of the clip, of which some are held."""
        self._look = lru_cache(HELD)(self._rendering)
        self._picture = self.frames.small
        self._core_distance = lru_cache(HELD)(lambda frame: _distance(self._core(frame)).astype(np.float16))
        self._whole = lru_cache(HELD)(self._found)
        self._clearance = lru_cache(HELD)(self._cleared)

    def share(self, frame: int) -> Floats:
        """How much of each pixel is an object's, [H, W] in [0, 1]: 1 on it and `GROWN` around it, falling to 0 over
        `FEATHER`.
        """
        covered, at = np.zeros(self._full, np.float32), around(self._whole(frame))
        if at is not None:
            region = at.grown(math.ceil((GROWN + FEATHER) * self._unit) + 1).scaled(self._full)
            mask = _enlarged(self._whole(frame).astype(np.float32), self._full)[region.part] >= COVERED
            distance = _distance(mask) * (256 / max(self._full))
            covered[region.part] = np.clip((GROWN + FEATHER - distance) / FEATHER, 0, 1)
        return covered

    def in_sight(self, frame: int, places: Floats) -> Mask:
        """Whether objects leave `places` [N, 2] of `frame` uncovered, pixels of the clip; False beyond its borders."""
        return sampled(self._clearance(frame).astype(np.float32), self._on_compared(places), outside=-1) >= 0

    def exposure(self, frame: int, other: int) -> Floats | None:
        """[3], what is to be added to the colours of `other`, 0 to 255, to have them as the scene is in `frame`.

        None where the two show too little of the same.
        """
        there = self._motion.field(frame, other, whole(self._compared))[::_SPARSE, ::_SPARSE]
        common = sampled(self._core_distance(other).astype(np.float32), there, outside=0) > GROWN * self._unit
        common &= self._core_distance(frame)[::_SPARSE, ::_SPARSE] > GROWN * self._unit
        if common.sum() * _SPARSE**2 < _LEAST_COMMON:
            return None
        theirs = sampled(self._picture(other), there[common]).astype(np.float32)
        return np.median(self._picture(frame)[::_SPARSE, ::_SPARSE][common] - theirs, axis=0)

    def scene(self, frame: int) -> Floats:
        """What the static volume has, [H, W, 3], 0 to 255, soft; continued smoothly where it has a hole."""
        return _enlarged(self._look(frame)[..., 1:].astype(np.float32), self._full)

    def _on_compared(self, places: Floats) -> Floats:
        """Pixels of the clip as pixels of the raster of comparison."""
        scale = np.array([self._compared[1] / self._full[1], self._compared[0] / self._full[0]], np.float32)
        return (places + 0.5) * scale - 0.5

    def _rendering(self, frame: int) -> npt.NDArray[np.float16]:
        """[h, w, 4], as rendered: how much a pixel moves, 0 to 1, and `scene`."""
        seen = look(self._tracker, frame, self._rendered)
        known = (seen.static_opacity > HOLE).astype(np.float32).reshape(self._rendered)
        scene = filled(255 * seen.rgb_static.reshape(*self._rendered, 3), known)
        moving = 1 - seen.static_confidence.reshape(*self._rendered, 1)
        return np.concatenate([moving, scene], axis=2).astype(np.float16)

    def _core(self, frame: int) -> Mask:
        """The rendered mask, on the raster of comparison."""
        return _enlarged(self._look(frame)[..., 0].astype(np.float32), self._compared) >= COVERED

    def _found(self, frame: int) -> Mask:
        """The mask and what hangs on it."""
        core = self._core(frame)
        at = around(core)
        if at is None:
            return core
        near = at.grown(math.ceil(REACH * self._unit))
        pixels = np.ones((2, 2), np.uint8)
        different = np.zeros(core.shape, np.uint8)
        different[near.part] = self._difference(frame, near) > DIFFERENT
        kept = np.asarray(cv2.morphologyEx(different, cv2.MORPH_OPEN, pixels)) > 0  # not edges a hair out of place
        joined = cv2.morphologyEx((kept | core).astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
        _, parts = cv2.connectedComponents(joined, connectivity=8)
        return np.isin(parts, np.unique(parts[core])) & (joined > 0)

    def _cleared(self, frame: int) -> npt.NDArray[np.float16]:
        """[h, w]: 1 where the share of objects is 0, falling to -1 at its rim and beyond."""
        beyond = _distance(self._whole(frame)) - (GROWN + FEATHER) * self._unit
        return beyond.clip(-1, 1).astype(np.float16)

    def _difference(self, frame: int, near: Raster) -> Floats:
        """[h, w] of the pixels `near` the mask: how far a frame's colours are beyond those that others show there.

        0 farther than `REACH` from the mask, and where too few frames show the scene.
        """
        picture = self._picture(frame)[near.part].astype(np.float32)
        views = []
        away = [sign * step for step in range(STRIDE, BESIDE + 1, STRIDE) for sign in (-1, 1)]
        for other in (frame + step for step in away if 0 <= frame + step < len(self.frames)):
            if not self._motion.knows(frame, other):
                continue
            exposure = self.exposure(frame, other)
            if exposure is None:
                continue
            there = self._motion.field(frame, other, near)
            view = sampled(self._picture(other), there) + exposure
            hides = sampled(self._core_distance(other).astype(np.float32), there, outside=0) <= GROWN * self._unit
            view[hides] = np.nan
            views.append(view)
        if len(views) < LEAST_VIEWS:
            return np.zeros(near.shape, np.float32)
        shown = np.stack(views)
        known = np.isfinite(shown[..., 0]).sum(axis=0) >= LEAST_VIEWS
        known &= self._core_distance(frame)[near.part] < REACH * self._unit
        scene, spread = picture.copy(), np.zeros_like(picture)
        scene[known] = known_median(shown[:, known])
        spread[known] = known_median(np.abs(shown[:, known] - scene[known]))
        around_it = np.ones((3, 3), np.uint8)
        beyond = np.maximum(picture - cv2.dilate(scene, around_it), cv2.erode(scene, around_it) - picture)
        return (beyond - SPREADS * spread).max(axis=2)


def _distance(mask: Mask) -> Floats:
    """Of each pixel from the mask; where there is none, more than any in the raster."""
    if not mask.any():
        return np.full(mask.shape, sum(mask.shape), np.float32)
    return cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE).astype(np.float32)


def _enlarged(image: Floats, size: tuple[int, int]) -> Floats:
    """At a (height, width)."""
    return cv2.resize(image, size[::-1], interpolation=cv2.INTER_LINEAR).astype(np.float32, copy=False)

"""Which pixels of a clip belong to its moving objects: the rendered motion mask, and what hangs on it.

The mask misses thin and fast parts, a leg or a foot, and knows nothing of shadows. Therefore each frame is compared
with what the frames around it show of the scene in the same place, brought there along the scene's motion: pixels that
differ, lie near the mask and are joined to it by such pixels are counted in.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import numpy.typing as npt

from decomo_runtime.contract import HOLE
from decomo_runtime.layers import look, raster_size
from decomotion.images import filled

if TYPE_CHECKING:
    from decomo_runtime.scene_motion import SceneMotion
    from decomo_runtime.tracker import Tracker

Image = npt.NDArray[np.uint8]
Floats = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

RENDERED_SIDE, COMPARED_SIDE = 128, 256
"""Most pixels of the longer side of the rasters on which the model is rendered, and on which frames are compared."""
WINDOW, STRIDE = 15, 3
"""A frame is compared with those up to this many frames away, every so many: the next ones show an object again."""
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
GROWN, FEATHER = 3.0, 3.0
"""How far beyond the object nothing of the clip is kept, and the width of the blend into it from there on."""


class Objects:
    """The moving objects of a clip, frame by frame; each frame is rendered and compared once.

    Args:
        tracker: the model.
        frames: uint8 [T, H, W, 3], the whole clip.
        motion: of the static scene.
    """

    def __init__(self, tracker: Tracker, frames: Image, motion: SceneMotion) -> None:
        self._tracker, self._frames, self._motion = tracker, frames, motion
        longer = max(tracker.height, tracker.width)
        self._rendered = raster_size(tracker.facts, min(RENDERED_SIDE, longer))
        self._compared = raster_size(tracker.facts, min(COMPARED_SIDE, longer))
        self._unit = max(self._compared) / 256
        self._looks: dict[int, npt.NDArray[np.float16]] = {}
        self._wholes: dict[int, Mask] = {}
        self._picture = lru_cache(2 * WINDOW)(self._shrunk)

    def share(self, frame: int) -> Floats:
        """How much of each pixel is an object's, [H, W] in [0, 1]: 1 on it and `GROWN` around it, falling to 0 over
        `FEATHER`.
        """
        if frame not in self._wholes:
            self._wholes[frame] = self._whole(frame)
        height, width = self._tracker.height, self._tracker.width
        distance = _distance(_enlarged(self._wholes[frame].astype(np.float32), (height, width)) >= COVERED)
        return np.clip((GROWN + FEATHER - distance * (256 / max(height, width))) / FEATHER, 0, 1).astype(np.float32)

    def scene(self, frame: int) -> Floats:
        """What the static volume has, [H, W, 3], 0 to 255, soft; continued smoothly where it has a hole."""
        size = self._tracker.height, self._tracker.width
        return _enlarged(self._look(frame)[..., 1:].astype(np.float32), size)

    def _look(self, frame: int) -> npt.NDArray[np.float16]:
        """[h, w, 4], as rendered: how much a pixel moves, 0 to 1, and `scene`."""
        if frame not in self._looks:
            seen = look(self._tracker, frame, self._rendered)
            known = (seen.static_opacity > HOLE).astype(np.float32).reshape(self._rendered)
            scene = filled(255 * seen.rgb_static.reshape(*self._rendered, 3), known)
            moving = 1 - seen.static_confidence.reshape(*self._rendered, 1)
            self._looks[frame] = np.concatenate([moving, scene], axis=2).astype(np.float16)
        return self._looks[frame]

    def _core(self, frame: int) -> Mask:
        """The rendered mask, on the raster of comparison."""
        return _enlarged(self._look(frame)[..., 0].astype(np.float32), self._compared) >= COVERED

    def _whole(self, frame: int) -> Mask:
        """The mask and what hangs on it."""
        core = self._core(frame)
        if not core.any():
            return core
        pixels = np.ones((2, 2), np.uint8)
        different = (self._difference(frame, core) > DIFFERENT).astype(np.uint8)
        kept = np.asarray(cv2.morphologyEx(different, cv2.MORPH_OPEN, pixels)) > 0  # not edges a hair out of place
        joined = cv2.morphologyEx((kept | core).astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
        _, parts = cv2.connectedComponents(joined, connectivity=8)
        return np.isin(parts, np.unique(parts[core])) & (joined > 0)

    def _difference(self, frame: int, core: Mask) -> Floats:
        """[h, w]: how far a frame's colours are beyond those that others show of the scene.

        0 far from the mask `core`, and where too few frames show the scene.
        """
        picture, size = self._picture(frame), self._compared
        scale = np.array([self._tracker.width / size[1], self._tracker.height / size[0]])
        grid = np.stack(np.meshgrid(np.arange(size[1]), np.arange(size[0])), axis=-1)
        views = []
        for other in range(frame % STRIDE, len(self._frames), STRIDE):
            if other == frame or abs(other - frame) > WINDOW or not self._motion.knows(frame, other):
                continue
            there = (self._motion.carry((grid + 0.5) * scale - 0.5, frame, other) + 0.5) / scale - 0.5
            view = sampled(self._picture(other), there.astype(np.float32), cv2.INTER_LINEAR)
            hides = sampled(self._core(other).astype(np.float32), there.astype(np.float32), cv2.INTER_LINEAR, outside=1)
            shows = (_distance(hides > 0) > GROWN * self._unit)[..., None]
            common = shows[..., 0] & ~core
            if common.any():
                views.append(np.where(shows, view + np.median((picture - view)[common], axis=0), np.nan))
        if len(views) < LEAST_VIEWS:
            return np.zeros(size, np.float32)
        shown = np.stack(views)
        known = np.isfinite(shown[..., 0]).sum(axis=0) >= LEAST_VIEWS
        known &= _distance(core) < REACH * self._unit
        scene, spread = picture.copy(), np.zeros_like(picture)
        scene[known] = np.nanmedian(shown[:, known], axis=0)
        spread[known] = np.nanmedian(np.abs(shown[:, known] - scene[known]), axis=0)
        around = np.ones((3, 3), np.uint8)
        beyond = np.maximum(picture - cv2.dilate(scene, around), cv2.erode(scene, around) - picture)
        return (beyond - SPREADS * spread).max(axis=2)

    def _shrunk(self, frame: int) -> Floats:
        size = self._compared[::-1]
        return cv2.resize(self._frames[frame], size, interpolation=cv2.INTER_AREA).astype(np.float32)


def sampled(image: npt.NDArray[Any], places: Floats, interpolation: int, outside: float | None = None) -> Any:
    """`image` [H, W] or [H, W, C] at `places` [H, W, 2]; beyond its borders it is `outside`, or goes on as there."""
    x, y, value = places[..., 0], places[..., 1], (0.0 if outside is None else outside,) * 4
    border = cv2.BORDER_REPLICATE if outside is None else cv2.BORDER_CONSTANT
    return cv2.remap(image, x, y, interpolation, borderMode=border, borderValue=value)


def _distance(mask: Mask) -> Floats:
    """Of each pixel from the mask; infinite where there is none."""
    if not mask.any():
        return np.full(mask.shape, np.inf, np.float32)
    return cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE).astype(np.float32)


def _enlarged(image: Floats, size: tuple[int, int]) -> Floats:
    """At a (height, width)."""
    return cv2.resize(image, size[::-1], interpolation=cv2.INTER_LINEAR).astype(np.float32, copy=False)

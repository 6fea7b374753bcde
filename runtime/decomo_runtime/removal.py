"""The clip without its moving objects: its own pixels, and behind the objects what other frames show of the scene.

A pixel that an object hides is followed along the motion of the static scene (`scene_motion.py`) to the frames, nearest
in time first, where no object covers it; the median of the colours found there replaces it. Before that each frame is
brought to the exposure of the one being made. What no frame shows is continued smoothly from around the hole, once, and
carried on to the frames made after it. (The static volume does not know it either: what it renders there is black.)
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import numpy.typing as npt

from decomo_runtime.rendering import look, raster_size
from decomo_runtime.scene_motion import SceneMotion, follow_scene, interpolate

if TYPE_CHECKING:
    from decomo_runtime.tracker import Tracker

Image = npt.NDArray[np.uint8]
Floats = npt.NDArray[np.float32]

MASK_SIDE = 128
"""Most pixels of the longer side of the raster on which masks are rendered."""
COLOURS = 5
"""Frames whose colours a pixel takes the median of."""
NEAR, STRIDE = 16, 4
"""Frames up to this distance are all looked at, farther ones every so many: neighbours show nearly the same."""
GROWN, FEATHER = 3.0, 3.0
"""Pixels of a frame whose longer side is 256: how far beyond the mask nothing of the clip is kept, and the width of the
blend into it from there on."""

_LEAST_COMMON = 64
"""Pixels of the scene that two frames must share for their exposure to be compared."""


def remove_objects(tracker: Tracker, frames: Image, wanted: Iterable[int]) -> Iterator[Image]:
    """Yields the `wanted` frames without their objects, uint8 [H, W, 3] RGB; `frames` [T, H, W, 3] is the whole clip.

    Raises `RenderError` where the model holds nothing to be static.
    """
    motion, objects = follow_scene(tracker), Objects(tracker)
    last: tuple[int, Image] | None = None
    for frame in wanted:
        share = objects.share(frame)[..., None]
        scene = np.where(share > 0, propagate(frames, frame, motion, objects), frames[frame])
        if last is not None and motion.knows(frame, last[0]):
            there = motion.field(frame, last[0])
            guessed = _sampled(last[1].astype(np.float32), there, cv2.INTER_LINEAR, outside=math.nan)
            scene = np.where(np.isnan(scene), guessed, scene)
        known = np.asarray(np.isfinite(scene).all(axis=2), np.float32)
        scene = interpolate(np.nan_to_num(scene), known)
        made = np.rint(share * scene + (1 - share) * frames[frame]).clip(0, 255).astype(np.uint8)
        last = frame, made
        yield made


class Objects:
    """How much of each pixel is to be replaced, frame by frame, from the rendered motion mask; rendered once each."""

    def __init__(self, tracker: Tracker) -> None:
        self._tracker = tracker
        self._size = raster_size(tracker.facts, min(MASK_SIDE, max(tracker.height, tracker.width)))
        self._masks: dict[int, npt.NDArray[np.float16]] = {}

    def share(self, frame: int) -> Floats:
        """[H, W] in [0, 1]: 1 on an object and `GROWN` around it, falling to 0 over `FEATHER`."""
        if frame not in self._masks:
            moving = 1 - look(self._tracker, frame, self._size).static_confidence
            self._masks[frame] = moving.reshape(self._size).astype(np.float16)
        height, width = self._tracker.height, self._tracker.width
        mask = cv2.resize(self._masks[frame].astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR)
        scene = (mask < 0.5).astype(np.uint8)
        if scene.all():
            return np.zeros((height, width), np.float32)
        distance = cv2.distanceTransform(scene, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) * (256 / max(height, width))
        return np.clip((GROWN + FEATHER - distance) / FEATHER, 0, 1).astype(np.float32)


def propagate(frames: Image, frame: int, motion: SceneMotion, objects: Objects) -> Floats:
    """[H, W, 3], 0 to 255: what other frames show of the scene behind the objects of `frame`.

    nan where no frame shows it, and where no object is.
    """
    hidden = objects.share(frame) > 0
    found = np.zeros(hidden.sum(), int)
    colours = np.full((COLOURS, len(found), 3), np.nan, np.float32)
    others = [other for other in range(len(frames)) if abs(other - frame) <= NEAR or (other - frame) % STRIDE == 0]
    for other in sorted(set(others) - {frame}, key=lambda other: abs(other - frame)):
        if (found == COLOURS).all():
            break
        if not motion.knows(frame, other):
            continue
        there = motion.field(frame, other)
        picture = _sampled(frames[other], there, cv2.INTER_CUBIC)
        covered = (objects.share(other) > 0).astype(np.float32)
        in_sight = _sampled(covered, there, cv2.INTER_LINEAR, outside=1) == 0
        common = in_sight & ~hidden
        if common.sum() < _LEAST_COMMON:
            continue
        exposure = np.median(frames[frame][common].astype(np.float32) - picture[common], axis=0)
        taken = np.flatnonzero(in_sight[hidden] & (found < COLOURS))
        colours[found[taken], taken] = picture[hidden][taken] + exposure
        found[taken] += 1
    behind = np.full(frames.shape[1:], np.nan, np.float32)
    shown = found > 0
    places = np.argwhere(hidden)[shown]
    behind[places[:, 0], places[:, 1]] = np.nanmedian(colours[:, shown], axis=0)
    return behind


def _sampled(
    image: npt.NDArray[Any], places: Floats, interpolation: int, outside: float | None = None
) -> npt.NDArray[Any]:
    """`image` [H, W] or [H, W, C] at `places` [H, W, 2]; beyond its borders it is `outside`, or goes on as there."""
    x, y, value = places[..., 0], places[..., 1], (0.0 if outside is None else outside,) * 4
    border = cv2.BORDER_REPLICATE if outside is None else cv2.BORDER_CONSTANT
    return cv2.remap(image, x, y, interpolation, borderMode=border, borderValue=value)

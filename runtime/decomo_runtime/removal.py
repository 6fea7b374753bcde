"""The clip without its moving objects: its own pixels, and behind the objects what other frames show of the scene.

A pixel that an object (`objects.py`) hides is followed along the motion of the static scene (`scene_motion.py`) to the
frames, nearest in time first, where no object covers it; the median of the colours found there replaces it. Before that
each frame is brought to the exposure of the one being made. What no frame shows is taken from the static volume,
which is continued smoothly over its holes, shifted to meet the colours around it; once, and carried on to the frames
made after it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from functools import lru_cache
from typing import TYPE_CHECKING

import cv2
import numpy as np
import numpy.typing as npt

from decomo_runtime.objects import HELD, FramesByNumber, Objects
from decomo_runtime.raster import Raster, around
from decomo_runtime.sampling import known_median, sampled
from decomo_runtime.scene_motion import SceneMotion, follow_scene
from decomotion.images import filled

if TYPE_CHECKING:
    from decomo_runtime.tracker import Tracker

Image = npt.NDArray[np.uint8]
Floats = npt.NDArray[np.float32]

COLOURS = 5
"""Frames whose colours a pixel takes the median of."""
NEAR, STRIDE, FAR = 16, 4, 96
"""Frames up to this distance are all looked at; farther ones, up to the last distance, those whose number is a multiple
of the stride, and the clip's last: neighbours show nearly the same, and frames made one after another look at the same.
"""
HELD_BYTES = 512 * 1024**2
"""Of frames that are held, decoded, for the next ones that look at them; no more than `HELD` frames."""


def remove_objects(tracker: Tracker, frames: FramesByNumber, wanted: Iterable[int]) -> Iterator[Image]:
    """Yields the `wanted` frames without their objects, uint8 [H, W, 3] RGB; `frames` [T] of such is the whole clip.

    Fastest where they are wanted in order: what is made of a frame is held for those around it. Raises `RenderError`
    where the model holds nothing to be static.
    """
    motion = follow_scene(tracker)
    held = HeldFrames(frames)
    objects = Objects(tracker, held, motion)
    last: tuple[int, Image] | None = None
    for frame in wanted:
        made = _without_objects(held, frame, motion, objects, last)
        last = frame, made
        yield made


def _without_objects(
    frames: FramesByNumber, frame: int, motion: SceneMotion, objects: Objects, last: tuple[int, Image] | None
) -> Image:
    """One frame; `last` is the one made before, with its number."""
    made, share = frames[frame].copy(), objects.share(frame)
    region = around(share > 0)
    if region is None:
        return made
    scene = made.astype(np.float32)
    behind, hidden = scene[region.part], share[region.part] > 0
    behind[hidden] = propagate(frames, frame, region, motion, objects)[hidden]
    unknown = np.isnan(behind).any(axis=2)
    if last is not None and unknown.any() and motion.knows(frame, last[0]):
        there = motion.field(frame, last[0], region)[unknown]
        behind[unknown] = sampled(last[1].astype(np.float32), there, outside=math.nan)
    known = np.asarray(np.isfinite(scene).all(axis=2), np.float32)
    if not known.all():
        rendered = objects.scene(frame)
        scene = rendered + filled(np.nan_to_num(scene - rendered), known)
    weight, own = share[region.part][..., None], made[region.part]
    made[region.part] = np.rint(weight * scene[region.part] + (1 - weight) * own).clip(0, 255)
    return made


def propagate(frames: FramesByNumber, frame: int, region: Raster, motion: SceneMotion, objects: Objects) -> Floats:
    """[h, w, 3], 0 to 255: what other frames show of the scene behind the objects of `frame`, in a `region` of it.

    nan where no frame shows it, and where no object is.
    """
    hidden = np.nonzero(objects.share(frame)[region.part] > 0)
    colours = np.full((COLOURS, len(hidden[0]), 3), np.nan, np.float32)
    found = np.zeros(len(hidden[0]), int)
    missing = np.arange(len(found))
    for other in others_of(frame, len(frames)):
        if len(missing) == 0:
            break
        if not motion.knows(frame, other):
            continue
        there = motion.field(frame, other, region)[hidden[0][missing], hidden[1][missing]]
        in_sight = objects.in_sight(other, there)
        taken = missing[in_sight]
        exposure = objects.exposure(frame, other) if len(taken) else None
        if exposure is None:
            continue
        colours[found[taken], taken] = sampled(frames[other], there[in_sight], cv2.INTER_CUBIC) + exposure
        found[taken] += 1
        missing = missing[found[missing] < COLOURS]
    behind = np.full((*region.shape, 3), np.nan, np.float32)
    behind[hidden] = known_median(colours)
    return behind


def others_of(frame: int, num_frames: int) -> list[int]:
    """The frames that are looked at for what `frame` hides, nearest in time first."""
    others = range(max(0, frame - FAR), min(num_frames, frame + FAR + 1))
    near = {other for other in others if abs(other - frame) <= NEAR}
    far = {other for other in others if other % STRIDE == 0 or other == num_frames - 1}
    return sorted((near | far) - {frame}, key=lambda other: abs(other - frame))


class HeldFrames:
    """The frames of a clip, of which those last asked for are held."""

    def __init__(self, frames: FramesByNumber) -> None:
        self._frames = frames
        count = max(2, min(HELD, HELD_BYTES // frames[0].nbytes))
        self._held = lru_cache(count)(lambda frame: frames[frame])

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, frame: int, /) -> Image:
        return self._held(frame)

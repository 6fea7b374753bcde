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
from typing import TYPE_CHECKING

import cv2
import numpy as np
import numpy.typing as npt

from decomo_runtime.footage import FramesByNumber, check_footage, others_of
from decomo_runtime.objects import Objects
from decomo_runtime.queries import check_frames
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


def remove_objects(tracker: Tracker, frames: FramesByNumber, wanted: Iterable[int]) -> Iterator[Image]:
    """Yields the `wanted` frames without their objects, uint8 [H, W, 3] RGB; `frames` [T] of such is the whole clip.

    Fastest where they are wanted in order: what is made of a frame is held for those around it. Raises `OverlayError`
    where `frames` are of another clip, `RenderError` where the model holds nothing to be static, `QueryError` where a
    wanted frame is none of the clip.
    """
    check_footage(frames, tracker.facts)
    return _removed(tracker, frames, wanted)


def _removed(tracker: Tracker, frames: FramesByNumber, wanted: Iterable[int]) -> Iterator[Image]:
    motion = follow_scene(tracker)
    objects = Objects(tracker, frames, motion)
    last: tuple[int, Image] | None = None
    for frame in wanted:
        (frame,) = check_frames([frame], tracker.num_frames).tolist()
        objects.frames.leave_behind(frame)
        made = _without_objects(objects.frames, frame, motion, objects, last)
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
        scene -= rendered
        scene = filled(np.nan_to_num(scene, copy=False), known)
        scene += rendered
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

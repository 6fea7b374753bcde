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

from decomo_runtime.objects import Objects, sampled
from decomo_runtime.scene_motion import SceneMotion, follow_scene
from decomotion.images import filled

if TYPE_CHECKING:
    from decomo_runtime.tracker import Tracker

Image = npt.NDArray[np.uint8]
Floats = npt.NDArray[np.float32]

COLOURS = 5
"""Frames whose colours a pixel takes the median of."""
NEAR, STRIDE = 16, 4
"""Frames up to this distance are all looked at, farther ones every so many: neighbours show nearly the same."""

_LEAST_COMMON = 64
"""Pixels of the scene that two frames must share for their exposure to be compared."""


def remove_objects(tracker: Tracker, frames: Image, wanted: Iterable[int]) -> Iterator[Image]:
    """Yields the `wanted` frames without their objects, uint8 [H, W, 3] RGB; `frames` [T, H, W, 3] is the whole clip.

    Raises `RenderError` where the model holds nothing to be static.
    """
    motion = follow_scene(tracker)
    objects = Objects(tracker, frames, motion)
    last: tuple[int, Image] | None = None
    for frame in wanted:
        share = objects.share(frame)[..., None]
        scene = np.where(share > 0, propagate(frames, frame, motion, objects), frames[frame])
        if last is not None and motion.knows(frame, last[0]):
            there = motion.field(frame, last[0])
            guessed = sampled(last[1].astype(np.float32), there, cv2.INTER_LINEAR, outside=math.nan)
            scene = np.where(np.isnan(scene), guessed, scene)
        known = np.asarray(np.isfinite(scene).all(axis=2), np.float32)
        if not known.all():
            rendered = objects.scene(frame)
            scene = rendered + filled(np.nan_to_num(scene - rendered), known)
        made = np.rint(share * scene + (1 - share) * frames[frame]).clip(0, 255).astype(np.uint8)
        last = frame, made
        yield made


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
        picture = sampled(frames[other], there, cv2.INTER_CUBIC)
        covered = (objects.share(other) > 0).astype(np.float32)
        in_sight = sampled(covered, there, cv2.INTER_LINEAR, outside=1) == 0
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

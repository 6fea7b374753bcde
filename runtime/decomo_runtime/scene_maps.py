"""Where the static scene's pixels are in another frame, each by the model's own answer, and behind objects as the scene
around them moves.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import cv2
import numpy as np
import numpy.typing as npt

from decomo_runtime.dense_maps import DenseMap
from decomo_runtime.layers import look, raster_size
from decomo_runtime.objects import RENDERED_SIDE
from decomotion.images import filled

if TYPE_CHECKING:
    from decomo_runtime.scene_motion import SceneMotion
    from decomo_runtime.tracker import Tracker

Floats = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

CLEARANCE, AGREED = 4.0, 1.5
"""The model's answers count this far from objects, and where they are within so much of how the scene around moves; in
pixels of a frame whose longer side is 256.
"""
OBJECT_SHARE = 0.25
"""More of a pixel's ray makes it an object's, in part at least."""
_SURE = 0.99


class SceneMaps:
    """Maps of the static scene between frames of the tracker's clip, by its `motion`."""

    def __init__(self, tracker: Tracker, motion: SceneMotion) -> None:
        self._tracker, self._motion = tracker, motion
        self._distance = lru_cache(1)(lambda frame: distance_from_objects(tracker, frame))

    def between(self, frame: int, other: int, seen: DenseMap) -> DenseMap:
        """The map of the scene at all pixels of `frame`; `seen` is what the model answers for them.

        Where the scene's motion between the two is not known, it is `seen`.
        """
        if not self._motion.knows(frame, other):
            return seen
        unit = max(seen.visible.shape) / 256
        clear = self._distance(frame) > CLEARANCE * unit
        return continued(self._motion.field(frame, other), seen, clear, AGREED * unit)


def continued(base: Floats, seen: DenseMap, wanted: Mask, agreed: float) -> DenseMap:
    """`seen` where it is `wanted`, in sight, and within `agreed` pixels of the places `base` [H, W, 2].

    Elsewhere `base`, and a smooth continuation of what parts the two.
    """
    apart = seen.places - base
    known = wanted & (seen.visible > _SURE) & (np.linalg.norm(apart, axis=-1) < agreed)
    beyond = filled(np.where(known[..., None], apart, 0), known.astype(np.float32))
    return DenseMap((base + beyond).astype(np.float32), np.ones_like(seen.visible))


def distance_from_objects(tracker: Tracker, frame: int) -> Floats:
    """[H, W]: how far each pixel of `frame` is from all objects, as the model renders them, coarsely; 0 on them."""
    size = tracker.height, tracker.width
    coarse = raster_size(tracker.facts, min(RENDERED_SIDE, max(size)))
    still = look(tracker, frame, coarse).static_confidence.reshape(coarse) >= 1 - OBJECT_SHARE
    if still.all():
        return np.full(size, sum(size), np.float32)
    enlarged = cv2.resize(still.astype(np.uint8), size[::-1], interpolation=cv2.INTER_NEAREST)
    return cv2.distanceTransform(enlarged, cv2.DIST_L2, cv2.DIST_MASK_PRECISE).astype(np.float32, copy=False)

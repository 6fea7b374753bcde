"""What frames whose objects are known say of the points that another frame shows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np
import numpy.typing as npt

from decomo_runtime.layers import pixel_queries
from decomotion.units import unit

if TYPE_CHECKING:
    from decomo_runtime.tracker import Tracker

Floats = npt.NDArray[np.float32]

FALL = 2.0
"""Power by which a point is seen worse as the expected error grows, in units."""


@dataclass(frozen=True, eq=False)
class Word:
    """Of one frame, at the pixels [h, w] of another one's raster."""

    shares: Mapping[int, Floats]
    """Of the objects that it knows, from 0 to 1."""
    sight: Floats
    """How much in sight the points are in it, from 0 to 1."""
    seen: Floats
    """How well they are seen: `sight`, less as their places may be farther off."""


def words(
    tracker: Tracker, frame: int, size: tuple[int, int], known: Mapping[int, Mapping[int, Floats]]
) -> dict[int, Word]:
    """Of each frame of `known`, the shares [h, w] of its objects on a raster of `size`, what it says of `frame`."""
    facts, asked = tracker.facts, list(known)
    tracks = tracker.track(pixel_queries(frame, size, facts), asked)
    whole, side = np.array([facts.width, facts.height]), np.float32(unit(facts.height, facts.width))
    scale = np.array([size[1] / facts.width, size[0] / facts.height], np.float32)
    said: dict[int, Word] = {}
    for column, other in enumerate(asked):
        there = tracks.xy[:, column]
        inside = ((there >= -0.5) & (there <= whole - 0.5)).all(axis=1)
        x, y = np.moveaxis(((there + 0.5) * scale - 0.5).reshape(*size, 2).astype(np.float32), -1, 0)
        sight = ((1 - tracks.occlusion[:, column] / facts.occlusion_threshold).clip(0, 1) * inside).astype(np.float32)
        error = np.float32(0) if tracks.error is None else tracks.error[:, column] / side
        shares = {number: _at(share, x, y) for number, share in known[other].items()}
        said[other] = Word(shares, sight.reshape(size), (sight * (1 + error) ** -FALL).reshape(size))
    return said


def _at(image: Floats, x: Floats, y: Floats) -> Floats:
    """Bilinear; the nearest pixel's beyond the borders."""
    return cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(np.float32, copy=False)

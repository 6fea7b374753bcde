"""Trusted tracks: corrected points bent through all that is known of them, and what is near them.

The model's track of a known place is right there, and somewhere on the way to the next one it goes wrong, as that
one's does on the way back: slowly, or where it takes one thing for another. A corrected point goes with the first and
ends with the second; it changes over where the two are near each other, and with time where they never are. Points
around a known place move along: the model says how they lie about the point, the bent track where that is. How much
that is trusted falls with the distance from the place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from decomotion.corrections.following import HIDDEN, Followed, follow, see
from decomotion.corrections.points import CorrectedPoint
from decomotion.model.fusion import DecoMotion

REACH = 3.0
"""Standard deviation, in units, of the trust in what lies around a known place."""
FARTHEST = 2.0
"""Standard deviations that are looked at."""
AROUND, FEWEST = 512, 5
"""Points around all places, about, and at least so many around each."""
MEET = 1.0
"""Distance in units below which tracks are as good as at one place."""
INFERRED = 0.5
"""Trust in a place of a frame in which none is known."""
STRAIN = 0.5
"""How much of their distance points around a place may come nearer to it, or farther, and still be of one surface."""
NOT_THE_SCENE = 2.0
"""Units by which the static volume misses a known place of what is no part of it."""
AGREES = 2.0
"""Units by which a link may miss where a trusted track leads, beside `STRAIN`, and not contradict it."""


@dataclass(frozen=True, eq=False)
class Bent:
    """A corrected point through all frames."""

    point: CorrectedPoint
    xy: npt.NDArray[np.float64]
    """[T, 2], pixels."""
    in_sight: npt.NDArray[np.bool_]
    """[T]."""
    moving: bool
    """Whether the dynamic volume is to have it."""


@dataclass(frozen=True, eq=False)
class TrustedTracks:
    """N points around known places, those themselves among them."""

    bent: Sequence[Bent]
    xy: npt.NDArray[np.float32]
    """[N, T, 2], pixels."""
    trust: npt.NDArray[np.float32]
    """[N, T], in [0, 1]; 0 where a point is hidden."""
    moving: npt.NDArray[np.bool_]
    """[N]: whether the dynamic volume is to have them."""


def trusted_tracks(model: DecoMotion, points: Sequence[CorrectedPoint]) -> TrustedTracks:
    """The tracks of corrected points, and of those around them, in a clip that `model` was fitted to."""
    places = sum(len(point.frames) for point in points)
    offsets = offsets_around(max(AROUND // places, FEWEST), REACH * model.plane.unit)
    bent, around = [], []
    for point in points:
        known = follow(model, point.queries)
        bent.append(_bent(model, point, known))
        around += [_around(model, bent[-1], known, number, offsets) for number in range(len(point.frames))]
    xy, trust, moving = (np.concatenate(part) for part in zip(*around, strict=True))
    return TrustedTracks(bent, xy.astype(np.float32), trust.astype(np.float32), moving)


def _bent(model: DecoMotion, point: CorrectedPoint, known: Followed) -> Bent:
    shares = blending(point.frames, known.xy / model.plane.unit)
    xy = np.einsum("kt,ktc->tc", shares, known.xy)
    xy[point.frames] = point.xy
    seen = np.einsum("kt,kt->t", shares, known.occlusion) < HIDDEN
    seen[point.frames] = True
    seen[point.hidden] = False
    looks = [see(model, int(frame), place[None]) for frame, place in zip(point.frames, point.xy, strict=True)]
    moving = any(bool(look.moving[0]) for look in looks)
    if not moving:
        missed = [
            np.linalg.norm(look.xy[0, point.frames] - point.xy, axis=-1).max() / model.plane.unit for look in looks
        ]
        moving = model.config.volumes != "static" and bool(max(missed) > NOT_THE_SCENE)
    return Bent(point, xy, seen, moving)


def blending(frames: npt.NDArray[np.int64], tracks: npt.NDArray[np.floating]) -> npt.NDArray[np.float64]:
    """[K, T]: how much of each of the `tracks` [K, T, 2], in units, of places known in `frames` [K] is in each frame.

    It adds up to 1. Before the first known place and after the last that one has it all; between two the second one's
    share grows from 0 to 1, in each step by as much as the inverse square of the distance between the tracks.
    """
    shares = np.zeros(tracks.shape[:2])
    shares[0, : frames[0]] = shares[-1, frames[-1] :] = 1
    for one, (begin, end) in enumerate(pairwise(frames)):
        apart = np.linalg.norm(tracks[one, begin : end + 1] - tracks[one + 1, begin : end + 1], axis=-1)
        step = 1 / ((apart[1:] + apart[:-1]) / 2 + MEET) ** 2
        second = np.concatenate([[0], np.cumsum(step)[:-1]]) / step.sum()
        shares[one, begin:end], shares[one + 1, begin:end] = 1 - second, second
    return shares


def _around(
    model: DecoMotion, bent: Bent, known: Followed, number: int, offsets: npt.NDArray[np.float64]
) -> tuple[npt.NDArray, npt.NDArray, npt.NDArray]:
    """`xy`, `trust` and `moving` of the points at `offsets` from known place `number`."""
    frame, place, own = int(bent.point.frames[number]), bent.point.xy[number], known.xy[number]
    plane = model.plane
    starts = place + offsets
    inside = ((starts >= -0.5) & (starts <= np.array([plane.width, plane.height]) - 0.5)).all(axis=-1)
    inside[0] = True  # the place itself: tracks are handed over at seams beyond the border too
    starts, offsets = starts[inside], offsets[inside]
    looks = see(model, frame, starts)
    alike = looks.moving == looks.moving[0]
    starts, offsets = starts[alike], offsets[alike]
    lie = looks.xy[alike] - own  # [n, T, 2], about the point
    lie[0], lie[:, frame] = 0, offsets
    distance = np.linalg.norm(offsets, axis=-1)
    torn = np.linalg.norm(lie - offsets[:, None], axis=-1) > STRAIN * distance[:, None] + 0.5 * plane.unit
    lie = np.where(torn[..., None], offsets[:, None], lie)
    near = np.exp(-0.5 * (distance / (REACH * plane.unit)) ** 2)
    certain = np.full(model.num_frames, INFERRED)
    certain[bent.point.frames] = 1
    trust = near[:, None] * certain * bent.in_sight * np.where(torn, 0.5, 1)
    xy = bent.xy + lie
    outside = ((xy < -0.5) | (xy > np.array([plane.width, plane.height]) - 0.5)).any(axis=-1)
    return xy, np.where(outside, 0, trust), np.full(len(xy), bent.moving)


def offsets_around(count: int, deviation: float) -> npt.NDArray[np.float64]:
    """About `count` offsets within `FARTHEST` deviations, (0, 0) first: a sunflower's seeds."""
    number = np.arange(count)
    radius = FARTHEST * deviation * np.sqrt(number / max(1, count - 1))
    angle = number * np.pi * (3 - 5**0.5)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


def contradiction(
    bent: Sequence[Bent],
    frame: npt.NDArray[np.integer],
    xy: npt.NDArray[np.floating],
    target: npt.NDArray[np.integer],
    target_xy: npt.NDArray[np.floating],
    unit: float,
) -> npt.NDArray[np.floating]:
    """How far links from `xy` [..., 2] in `frame` [...] to `target_xy` in `target` contradict bent tracks, 0 to 1.

    A link does where one of its ends is near a corrected point and the other is not where the point then is, or where
    it follows the point to or from a frame in which that is known to be hidden. `unit` is in pixels of the clip.
    """
    worst = np.zeros(np.broadcast_shapes(frame.shape, target.shape, xy.shape[:-1], target_xy.shape[:-1]))
    for each in bent:
        hidden = np.zeros(len(each.xy), np.bool_)
        hidden[each.point.hidden] = True
        followed = each.in_sight[frame] & each.in_sight[target]
        lost = hidden[frame] | hidden[target]
        for one, one_xy, other, other_xy in ((frame, xy, target, target_xy), (target, target_xy, frame, xy)):
            offset = one_xy - each.xy[one]
            distance = np.linalg.norm(offset, axis=-1)
            near = np.exp(-0.5 * (distance / (REACH * unit)) ** 2)
            miss = np.linalg.norm(other_xy - each.xy[other] - offset, axis=-1)
            agrees = miss <= AGREES * unit + STRAIN * distance
            worst = np.maximum(worst, np.where((followed & ~agrees) | (lost & agrees), near, 0))
    return worst

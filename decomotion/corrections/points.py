"""Corrected points: lines of corrections that speak of one point, taken together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from decomotion.errors import CorrectionError

SAME = 0.01
"""Pixels by which two places differ that are one."""


class Place(NamedTuple):
    """A point of a frame; x and y in pixels of the clip, NaN where it is hidden there."""

    t: int
    x: float
    y: float


@dataclass(frozen=True, eq=False)
class CorrectedPoint:
    """A point and all that is known of it."""

    frames: npt.NDArray[np.int64]
    """[K], at least one, ascending: in which its place is known."""
    xy: npt.NDArray[np.float64]
    """[K, 2], pixels of the clip: the places."""
    hidden: npt.NDArray[np.int64]
    """[H], ascending: the frames in which it is known to be hidden."""

    @staticmethod
    def of(places: Sequence[Place]) -> CorrectedPoint:
        """The point that is at these places, one a frame, those where it is hidden among them."""
        ordered = sorted(places)
        known = [place for place in ordered if not math.isnan(place.x)]
        xy = np.array([place[1:] for place in known], np.float64).reshape(-1, 2)
        hidden = [place.t for place in ordered if math.isnan(place.x)]
        return CorrectedPoint(np.array([place.t for place in known], np.int64), xy, np.array(hidden, np.int64))

    @property
    def queries(self) -> npt.NDArray[np.float64]:
        """[K, 3], the known places as rows of (t, x, y)."""
        return np.column_stack([self.frames.astype(np.float64), self.xy])

    @property
    def places(self) -> list[Place]:
        """What `of` makes a point of, in the order of frames."""
        known = [Place(int(t), float(x), float(y)) for t, (x, y) in zip(self.frames, self.xy, strict=True)]
        return sorted([*known, *(Place(int(t), math.nan, math.nan) for t in self.hidden)])


@dataclass
class _Found:
    """A point as lines name it."""

    places: dict[int, tuple[Place, str]] = field(default_factory=dict)
    """By frame, with where it was said."""

    def is_at(self, place: Place) -> bool:
        return place.t in self.places and _same(self.places[place.t][0], place)

    def add(self, place: Place, where: str) -> None:
        known = self.places.setdefault(place.t, (place, where))
        if not _same(known[0], place):
            raise CorrectionError(
                f"{where} says that a point is {_told(place)} in frame {place.t}, but {known[1]} that it is "
                f"{_told(known[0])}; leave one of them out"
            )


def points_of(lines: Sequence[tuple[str, tuple[Place, Place]]]) -> list[CorrectedPoint]:
    """The points of lines, each (where it stands, (place, target)), in the order in which they are first named.

    Lines that share a place in sight speak of one point. Raises `CorrectionError` where that would be at two places in
    a frame, or both seen and hidden.
    """
    points: list[_Found] = []
    for where, ends in lines:
        seen = [end for end in ends if not math.isnan(end.x)]
        meant = [each for each in points if any(each.is_at(end) for end in seen)]
        point = meant[0] if meant else _Found()
        if not meant:
            points.append(point)
        for other in meant[1:]:  # this line is what tells that they are one
            points.remove(other)
            for place, said in other.places.values():
                point.add(place, said)
        for end in ends:
            point.add(end, where)
    return [CorrectedPoint.of([place for place, _ in each.places.values()]) for each in points]


def _same(one: Place, other: Place) -> bool:
    if math.isnan(one.x) or math.isnan(other.x):
        return math.isnan(one.x) and math.isnan(other.x)
    return math.dist(one[1:], other[1:]) <= SAME


def _told(place: Place) -> str:
    return "hidden" if math.isnan(place.x) else f"at ({place.x:g}, {place.y:g})"

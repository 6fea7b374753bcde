"""Tracks as tools with keyframes take them: by point, only where it is in sight, in the tool's frames and coordinates.

Most tools count pixels from a corner of the frame, edge to edge, so that the first pixel's centre is at 0.5:
`from_top_left` and `from_bottom_left`.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from decomo_runtime.errors import TracksFileError
from decomo_runtime.formats.about import About
from decomo_runtime.formats.frames import in_order, likelihood, unique_names
from decomo_runtime.tracks import Tracks

log = logging.getLogger(__name__)

Places = npt.NDArray[np.float64]
T = TypeVar("T")
_SECONDS = 2
"""Before a bar is shown."""


@dataclass(frozen=True, eq=False)
class Keys:
    """One point where it is in sight."""

    name: str
    """Of letters, digits, dots, dashes and underscores; no two points have the same, not even in capitals."""
    numbers: npt.NDArray[np.int64]
    """[K], frame numbers of the tool, rising."""
    xy: Places
    """[K, 2], as `Tracks.xy`."""
    likelihood: npt.NDArray[np.float64]
    """[K], from 0 to 1 (`frames.py`)."""
    all_numbers: npt.NDArray[np.int64]
    """[M], of all frames in which the point was looked for, rising."""

    def starts(self) -> npt.NDArray[np.bool_]:
        """[K], True where the frame before this one has no key."""
        return np.diff(self.numbers, prepend=self.numbers[0] - 2) != 1

    def seen(self) -> npt.NDArray[np.bool_]:
        """[M], True in the frames that have a key."""
        return np.isin(self.all_numbers, self.numbers)


def keyed(tracks: Tracks, about: About, first: int) -> list[Keys]:
    """The points that are in sight anywhere; a line tells of those that are not. `first`: see `About.numbers`.

    Raises `TracksFileError` where a point in sight has no finite place, or the clip's size is not known.
    """
    tracks = in_order(tracks)
    numbers = about.numbers(tracks.frames, first)
    in_sight = ~tracks.occluded
    names = plain_names(about.names(len(tracks.xy)))
    sure, points = likelihood(tracks, about), []
    for point in np.flatnonzero(in_sight.any(axis=1)).tolist():
        seen = in_sight[point]
        xy = tracks.xy[point, seen].astype(np.float64)
        points.append(Keys(names[point], numbers[seen], xy, sure[point, seen], numbers))
    missing = len(names) - len(points)
    if not points:
        raise TracksFileError("no point is in sight in any of the frames, so that there are no keys to write")
    if missing:
        log.info("%d of %d points are in sight in none of the frames and are left out", missing, len(names))
    return points


def shown(things: Sequence[T], words: str = "points") -> Iterator[T]:
    """The things one by one, with a bar on a terminal where there are many."""
    return iter(tqdm(things, words, delay=_SECONDS, leave=False, disable=None))


def from_top_left(xy: Places) -> Places:
    """x to the right and y down from the frame's top left corner, in pixels."""
    return xy + 0.5


def from_bottom_left(xy: Places, height: int) -> Places:
    """x to the right and y up from the frame's bottom left corner, in pixels."""
    return np.stack([xy[:, 0] + 0.5, height - 0.5 - xy[:, 1]], axis=1)


def plain_names(names: Sequence[str]) -> list[str]:
    """Names without what some tool cannot read: other characters become underscores, and equal names get a number."""
    return unique_names([re.sub(r"[^A-Za-z0-9.-]+", "_", name).strip("._-") or "point" for name in names])

"""What linking costs on this machine, and what follows it, and how many points are affordable.

A point is carried from frame to frame by flow, and found again by matches where flow is lost: a hop of each kind has
its own cost. Both are measured on a few frames of the clip, with as many points at a time as there will be.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from decomotion.clip import Clip
from decomotion.data.flow.interface import Size
from decomotion.data.links.linking import Rematching, link
from decomotion.data.links.matcher import Matches
from decomotion.data.links.refinement import Refiner
from decomotion.data.timing import least_seconds

FRAMES, GAPS, MATCHED = 6, (1, 2), (2, 3)
"""Of a trial of linking: frames, gaps of flow, gaps of matches."""
BLOCK = 250_000
"""Points of all frames together in a trial: more than a processor's cache holds, as in long clips."""
LOST, TRUSTED = 0.5, 0.1
"""In a trial: share of the points that flow loses, and of the matches that are trusted, as in clips of many frames."""
MIN_POINTS = 256
"""Points a frame below which a pool is of no use."""


@dataclass(frozen=True)
class HopCosts:
    """Seconds in which one point is carried over one gap."""

    flow: float
    match: float

    def times(self, rounds: float) -> HopCosts:
        """Of a point that is carried so often."""
        return HopCosts(rounds * self.flow, rounds * self.match)

    def of_a_point(self, frames: int, gaps: tuple[int, ...], matched: tuple[int, ...], max_gap: int) -> float:
        """Seconds in which one point of every frame is linked to every other, by flow over `gaps` and by matches."""
        return self.flow * hops(frames, gaps, max_gap) + self.match * hops(frames, matched, max_gap)


@dataclass(frozen=True)
class LaterCosts:
    """Seconds that what follows the links takes."""

    fixed: float
    """However many points are linked."""
    each: float
    """For each point of a frame."""

    def of(self, points: int) -> float:
        """For so many points of a frame."""
        return self.fixed + points * self.each


@dataclass(frozen=True)
class Costs:
    """Of linking, and of what follows it."""

    hop: HopCosts
    later: LaterCosts

    def of_a_point(self, frames: int, gaps: tuple[int, ...], matched: tuple[int, ...], max_gap: int) -> float:
        """Seconds that a point of every frame takes in all; see `HopCosts.of_a_point`."""
        return self.later.each + self.hop.of_a_point(frames, gaps, matched, max_gap)


def later_costs(seconds: Callable[[int], float], wanted: int) -> LaterCosts:
    """By what `seconds` says of the fewest points and of all that are wanted."""
    fewest = min(wanted, MIN_POINTS)
    few = seconds(fewest)
    each = 0.0 if wanted == fewest else max(0.0, seconds(wanted) - few) / (wanted - fewest)
    return LaterCosts(max(0.0, few - fewest * each), each)


def hop_costs(clip: Clip, raster: Size, points: int) -> HopCosts:
    """Measured on some frames of `clip` with fields of that width and height, and at most so many points a frame."""
    piece = replace(clip, frames=clip.frames[:FRAMES], times=clip.times[:FRAMES])
    frames = len(piece)
    width, height = raster
    still = np.zeros((height, width, 2), np.float32)
    astray = still.copy()
    astray[: max(1, round(LOST * height))] = height / 4  # and does not return
    block = max(1, min(BLOCK, points * len(clip)) // frames)
    across = np.linspace(0, 1, block, dtype=np.float32)
    one_frame = np.stack([across * 997 % 1 * (width - 1), across * (height - 1)], axis=-1).astype(np.float32)
    where = np.repeat(one_frame[None], frames, axis=0)
    rows, columns = height // 2 + 1, width // 2 + 1
    trusted = np.arange(rows * columns).reshape(rows, columns) % round(1 / TRUSTED) == 0
    cells = Matches(np.zeros((rows, columns, 2), np.float32), trusted)
    found = Rematching(lambda *_: cells, MATCHED, Refiner(piece))

    def linked(rematching: Rematching | None) -> None:
        for step in (1, -1):
            for _ in link(where, lambda i, j: astray if i < j else still, GAPS, 1.0, frames, step, rematching):
                pass

    by_flow = least_seconds(lambda: linked(None))
    by_both = least_seconds(lambda: linked(found))
    of_flow, of_matches = (block * max(1, hops(frames, gaps, frames)) for gaps in (GAPS, MATCHED))
    return HopCosts(by_flow / of_flow, max(0.0, by_both - by_flow) / of_matches)


def hops(frames: int, gaps: tuple[int, ...], max_gap: int) -> int:
    """How often a point of each frame is carried over one of `gaps`, over all frames and in both directions of time."""
    return sum(2 * (frames - away) for gap in gaps for away in range(gap, min(frames - 1, max_gap) + 1))


def affordable_points(wanted: int, each: float, seconds: float) -> int:
    """Points of each frame whose links take so many seconds, where one's take `each`: not uselessly few, nor more than
    `wanted`."""
    return int(max(min(wanted, MIN_POINTS), min(wanted, seconds / each)))

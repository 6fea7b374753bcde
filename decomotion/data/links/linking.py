"""Linking: correspondences over any gap, composed of direct flows over a few gaps.

Flow over one frame drifts when it is chained; flow over sixteen often fails outright. Each point is therefore
carried from its source frame outward, and at each new frame the best of several last hops is kept: from 1, 2, 4,
... frames before, whichever has accumulated the least squared error (as MFT does, Neoral et al. 2024, with a learned
uncertainty where we have the forward-backward error). A point hidden in between is found again by a longer hop
over its occlusion.

Errors are counted in units of a pixel of a frame whose longer side is 256, so that thresholds mean the same at any
resolution; positions are in pixels of the flow's raster.

Where no hop by flow ends on a visible place, a match by appearance may (`decomotion/data/links/matching.py`).
What is known to move has a second way to go, the flow of it alone (`decomotion/data/links/layer.py`), and is hidden
where a hop leaves its masks: those that are given, or, for a place that looks otherwise, those that a network drew.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from decomotion.data.flow.interface import Flow
from decomotion.data.sampling import bilinear, nearest
from decomotion.units import unit

if TYPE_CHECKING:  # it needs torch, which linking does not
    from decomotion.data.links.matcher import Matches

Xy = npt.NDArray[np.float32]
FlowLookup = Callable[[int, int], Flow]
MatchLookup = Callable[[int, int], "Matches"]
MaskLookup = Callable[[int], npt.NDArray[np.bool_]]
LookLookup = Callable[[int], npt.NDArray[np.uint8]]
_Which = slice | npt.NDArray[np.int64]
RefineLookup = Callable[[int, int, Xy, Xy, tuple[int, ...]], Xy]

HOP_VARIANCE = 0.1**2
"""Squared error, in units^2, that every hop adds whatever its cycle error: prefers few hops to many."""
GAP_VARIANCE = 0.003
"""Squared error, in units^2 per squared gap, that a hop adds as well: flow is less exact over longer gaps."""
MATCH_VARIANCE = 3.0
"""Squared error, in units^2, that a hop by a match adds."""
CYCLE_SHARE = 0.3
"""Share of a hop's squared cycle error that is counted as its own squared error."""
CYCLE_LIMIT = 20.0
"""Cycle errors are counted up to here, in units."""
AT_ONCE = 2**14
"""Points that are carried at a time: what is worked on stays in the processor's cache."""
MOST = 0.7
"""Where more than this share of them has to be carried, all are, which saves gathering them."""
BYTES_A_POINT = 13
"""Of a point of one source frame in one frame that was reached; they are kept for the longest gap."""
UNLIKE = 12.0
"""Grey levels, the mean of three channels, by which a place differs from a point that is not there."""
OCCLUSION_COST = 10.0
"""Squared units that a hop onto a hidden place costs: any visible path is preferred up to this error."""


@dataclass(frozen=True)
class Rematching:
    """How points are found again by their looks where no hop by flow ends on a visible place."""

    match: MatchLookup
    """`match(i, j)` are the matches from frame i to frame j."""
    intervals: tuple[int, ...]
    """The gaps for which `match` can be asked."""
    refine: RefineLookup | None = None
    """`refine(i, j, xy, found, raster)` are better places in frame j of the points at `xy` in frame i than those
    `found` by a match, all [point, 2] in pixels of the flow's raster (height, width)."""


@dataclass(frozen=True)
class Moving:
    """What moves."""

    flow: FlowLookup
    """`flow(i, j)` is the flow of it alone from frame i to frame j, [h, w, 2]."""
    mask: MaskLookup
    """`mask(i)`: [h, w], it in frame i."""
    reach: MaskLookup | None
    """`reach(i)`: [h, w], where it can lie in frame i, and is hidden elsewhere; None: anywhere."""
    look: LookLookup | None = None
    """`look(i)`: frame i, [h, w, 3]: out of reach a point is hidden only where that looks otherwise than it does."""


@dataclass(frozen=True)
class Links:
    """Where the points of all source frames lie in one target frame. Axes: source frame, point."""

    target: int
    sources: npt.NDArray[np.int64]
    """[source]: the source frames, all on one side of the target."""
    xy: Xy
    """[source, point, 2]: positions in pixels of the flow's raster."""
    variance: npt.NDArray[np.float32]
    """[source, point]: accumulated squared error, units^2."""
    occluded: npt.NDArray[np.bool_]
    """[source, point]: hidden or outside the image; the position is then a guess."""


def cycle_error(xy: Xy, there: Xy, backward: Flow) -> npt.NDArray[np.float32]:
    """Distance in pixels between `xy` and where `backward` leads from `there`. Shapes [..., 2]; result [...]."""
    missed = there + bilinear(backward, there) - xy
    return np.sqrt(missed[..., 0] ** 2 + missed[..., 1] ** 2)  # norm() takes ten times as long


def outside(xy: Xy, height: int, width: int) -> npt.NDArray[np.bool_]:
    """Whether positions lie outside the image [-0.5, W - 0.5] x [-0.5, H - 0.5]."""
    x, y = xy[..., 0], xy[..., 1]
    return (x < -0.5) | (x > width - 0.5) | (y < -0.5) | (y > height - 0.5)


def link(
    points: Xy,
    flow: FlowLookup,
    intervals: tuple[int, ...],
    cycle_threshold: float,
    max_gap: int,
    step: int,
    rematching: Rematching | None = None,
    moving: Moving | None = None,
) -> Iterator[Links]:
    """Carries the points of every frame through the clip in one direction.

    Args:
        points: [frame, point, 2], positions in pixels of the flow's raster, in each frame.
        flow: `flow(i, j)` is the flow from frame i to frame j, [h, w, 2].
        intervals: the gaps for which `flow` can be asked.
        cycle_threshold: cycle error in units above which a hop ends on a hidden place.
        max_gap: longest gap between source and target.
        step: +1 to go forward in time, -1 backward.
        rematching: beside flow, matches by appearance.
        moving: what moves, where that is known: another way for it beside `flow`.

    Yields: `Links` for each target frame that has sources, in the order of travel.
    """
    order = range(len(points)) if step > 0 else range(len(points) - 1, -1, -1)
    longest = max(intervals + (rematching.intervals if rematching else ()))
    reached: dict[int, _State] = {}
    moves = None if moving is None else [nearest(moving.mask(frame), xy) for frame, xy in enumerate(points)]

    looks = []
    if moving is not None and moving.look is not None:
        looks = [np.round(bilinear(moving.look(frame), xy)).astype(np.uint8) for frame, xy in enumerate(points)]

    def bounds_of(start: _State, target: int) -> _Bounds | None:
        if moving is None or moves is None:
            return None
        of_sources = np.stack([moves[source] for source in start.sources])
        reach = None if moving.reach is None else moving.reach(target)
        if moving.look is None:
            return _Bounds(of_sources, reach)
        its_looks = np.stack([looks[source] for source in start.sources])
        return _Bounds(of_sources, reach, _Looks(its_looks, moving.look(target)))

    for target in order:
        own = _State.of(target, points[target])
        starts = list(_starts(reached, target, intervals, max_gap, step))
        if starts:
            best = _State.unreached(starts[0][1].sources, own)
            for origin, start in starts:
                gap = abs(target - origin)
                both, bounds = (flow(origin, target), flow(target, origin)), bounds_of(start, target)
                _hop(best, start, *both, gap, cycle_threshold, bounds)
                if moving and bounds and moving.mask(origin).any() and moving.mask(target).any():
                    alone = replace(start, variance=np.where(bounds.moves, start.variance, np.float32(np.inf)))
                    both = moving.flow(origin, target), moving.flow(target, origin)
                    _hop(best, alone, *both, gap, cycle_threshold, bounds)
            if rematching is not None:
                raster = flow(target, target - step).shape[:2]
                again = list(_starts(reached, target, rematching.intervals, max_gap, step))
                _find_again(best, again, target, rematching, raster, lambda start, to=target: bounds_of(start, to))
            yield Links(target, best.sources[:-1], best.xy[:-1], best.variance[:-1], best.occluded[:-1])
            own = best
        reached[target] = own
        for origin in [frame for frame in reached if abs(frame - target) >= longest]:
            del reached[origin]


@dataclass(frozen=True)
class _Looks:
    """How points look in their own frames, and a frame to which they are carried."""

    of_points: npt.NDArray[np.uint8]
    """[source, point, 3]."""
    frame: npt.NDArray[np.uint8]
    """[h, w, 3]."""

    def differ(self, which: _Which, some: npt.NDArray[np.int64], there: Xy) -> npt.NDArray[np.bool_]:
        """Of the points at flat indices, whether `some` of them look otherwise than the frame where they are now."""
        its = self.of_points.reshape(-1, 3)[which][some].astype(np.float32)
        return np.abs(its - bilinear(self.frame, there)).mean(axis=-1) > UNLIKE


@dataclass(frozen=True)
class _Bounds:
    """Where points can end in one frame."""

    moves: npt.NDArray[np.bool_]
    """[source, point]: whether they move."""
    reach: npt.NDArray[np.bool_] | None
    """[h, w]: where what moves can lie; elsewhere it is gone."""
    looks: _Looks | None = None
    """Where it looks as the point does it is not gone, if this is known."""

    def gone(self, which: _Which, there: Xy) -> npt.NDArray[np.bool_]:
        """Whether points at flat indices are, at `there`."""
        moves = self.moves.reshape(-1)[which]
        if self.reach is None:
            return np.zeros_like(moves)
        gone = moves & ~nearest(self.reach, there)
        outside_it = np.flatnonzero(gone)
        if self.looks is not None and len(outside_it):
            gone[outside_it] = self.looks.differ(which, outside_it, there[outside_it])
        return gone


@dataclass(frozen=True)
class _State:
    """The points of several source frames, in the order of travel, as they lie in one frame."""

    sources: npt.NDArray[np.int64]
    xy: Xy
    variance: npt.NDArray[np.float32]
    occluded: npt.NDArray[np.bool_]

    @staticmethod
    def of(frame: int, points: Xy) -> _State:
        """The points of one frame, in it."""
        xy = points[None].astype(np.float32)
        return _State(np.array([frame]), xy, np.zeros(xy.shape[:2], np.float32), np.zeros(xy.shape[:2], np.bool_))

    @staticmethod
    def unreached(sources: npt.NDArray[np.int64], own: _State) -> _State:
        """Points of `sources` that no hop has carried yet, which costs more than any; the frame's own last."""
        shape = (len(sources) + 1, *own.variance.shape[1:])
        xy, occluded = np.empty((*shape, 2), np.float32), np.zeros(shape, np.bool_)
        variance = np.full(shape, np.inf, np.float32)
        xy[-1], variance[-1] = own.xy[0], 0
        return _State(np.append(sources, own.sources), xy, variance, occluded)

    def later(self, first: int) -> _State:
        """Without the `first` sources, nothing copied."""
        return _State(self.sources[first:], self.xy[first:], self.variance[first:], self.occluded[first:])

    def cost(self, which: _Which) -> npt.NDArray[np.float32]:
        """Of its points at flat indices, by which one way is preferred to another."""
        return self.variance.reshape(-1)[which] + np.float32(OCCLUSION_COST) * self.occluded.reshape(-1)[which]

    def take(self, other: _State, which: npt.NDArray[np.int64]) -> None:
        """What `other` has, one after the other, becomes that of the points at the flat indices `which`."""
        _as_numbers(self.xy)[which] = _as_numbers(other.xy)
        self.variance.reshape(-1)[which] = other.variance
        self.occluded.reshape(-1)[which] = other.occluded


def _as_numbers(xy: Xy) -> npt.NDArray[np.complex64]:
    """Positions [..., 2], flat, each as one number: numpy gathers and scatters those many times as fast as pairs."""
    return xy.reshape(-1, 2).view(np.complex64)[:, 0]


def _positions(state: _State, which: _Which) -> Xy:
    """[point, 2], those at flat indices."""
    return _as_numbers(state.xy)[which].view(np.float32).reshape(-1, 2)


def _starts(
    reached: dict[int, _State], target: int, intervals: tuple[int, ...], max_gap: int, step: int
) -> Iterator[tuple[int, _State]]:
    """The frames from which a hop over one of the gaps leads to the target, nearest first, with the points there."""
    for origin in (target - gap * step for gap in sorted(intervals) if gap <= max_gap):
        if origin in reached:
            sources = reached[origin].sources
            yield origin, reached[origin].later(int((np.abs(sources - target) > max_gap).sum()))


def _hop(
    best: _State,
    start: _State,
    forward: Flow,
    backward: Flow,
    gap: int,
    cycle_threshold: float,
    bounds: _Bounds | None,
) -> None:
    """Carries points by flow, those that it can carry at less cost than `best` has, which takes them over."""
    height, width = forward.shape[:2]
    added = HOP_VARIANCE + GAP_VARIANCE * gap**2

    def carried(which: _Which) -> _State:
        xy = _positions(start, which)
        there = xy + bilinear(forward, xy)
        error = cycle_error(xy, there, backward) / np.float32(unit(height, width))
        gone = outside(there, height, width)
        if bounds is not None:
            gone |= bounds.gone(which, there)
        error[gone] = CYCLE_LIMIT
        occluded = start.occluded.reshape(-1)[which] | gone | (error > cycle_threshold)
        np.minimum(error, np.float32(CYCLE_LIMIT), out=error)
        variance = start.variance.reshape(-1)[which] + np.float32(added) + np.float32(CYCLE_SHARE) * error * error
        return _State(start.sources, there, variance.astype(np.float32), occluded)

    for _ in _improved(best, start, added, carried):
        pass


def _find_again(
    best: _State,
    starts: list[tuple[int, _State]],
    target: int,
    rematching: Rematching,
    raster: tuple[int, ...],
    bounds_of: Callable[[_State], _Bounds | None],
) -> None:
    """Gives `best` the points that a match from one of `starts` finds at less cost, and has them refined."""
    via = np.full(best.variance.size, -1, np.int8)
    for number, (origin, start) in enumerate(starts):
        matches = rematching.match(origin, target)
        hop = partial(_match_hop, start, matches, raster, bounds_of(start))
        for which in _improved(best, start, MATCH_VARIANCE, hop):
            via[which] = number
    if rematching.refine is None:
        return
    via[best.occluded.reshape(-1)] = -1
    found = best.xy.reshape(-1, 2)
    for number, (origin, start) in enumerate(starts):
        which = np.flatnonzero(via == number)
        found[which] = rematching.refine(origin, target, _positions(start, which), found[which], raster)


def _match_hop(
    start: _State, matches: Matches, raster: tuple[int, ...], bounds: _Bounds | None, which: _Which
) -> _State:
    """To where the cell that holds each point was matched, in pixels of a flow's `raster` (height, width)."""
    rows, columns = matches.trusted.shape
    pixels = np.array([raster[1] / columns, raster[0] / rows], np.float32)
    xy = _positions(start, which)
    column, row = np.floor((xy + np.float32(0.5)) / pixels).astype(np.int64).T
    column, row = column.clip(0, columns - 1), row.clip(0, rows - 1)
    there = (xy + matches.displacement[row, column] * pixels).astype(np.float32)
    hidden = ~matches.trusted[row, column] | outside(there, raster[0], raster[1])
    if bounds is not None:
        hidden |= bounds.gone(which, there)
    variance = start.variance.reshape(-1)[which] + np.float32(MATCH_VARIANCE)
    return _State(start.sources, there, variance, start.occluded.reshape(-1)[which] | hidden)


def _improved(
    best: _State, start: _State, least: float, carried: Callable[[_Which], _State]
) -> Iterator[npt.NDArray[np.int64]]:
    """Point by point, `best` takes over what costs less than it has; yields the flat indices of what it took.

    `carried(which)` are the points of `start` at flat indices, a hop later, which costs them `least` or more: where
    that is too much already, it is not asked. `start` may lack the latest sources of `best`.
    """
    for first in range(0, start.variance.size, AT_ONCE):
        part = slice(first, min(first + AT_ONCE, start.variance.size))
        worth = np.flatnonzero(start.cost(part) + np.float32(least) < best.cost(part))
        if not len(worth):
            continue
        which: _Which = worth + first if len(worth) < MOST * (part.stop - first) else part
        hop, before = carried(which), best.cost(which)
        cheaper = np.flatnonzero(hop.variance + np.float32(OCCLUSION_COST) * hop.occluded < before)
        taken = cheaper + first if isinstance(which, slice) else which[cheaper]
        best.take(_State(hop.sources, _positions(hop, cheaper), hop.variance[cheaper], hop.occluded[cheaper]), taken)
        yield taken

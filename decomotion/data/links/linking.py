"""Linking: correspondences over any gap, composed of direct flows over a few gaps.

Flow over one frame drifts when it is chained; flow over sixteen often fails outright. Each point is therefore
carried from its source frame outward, and at each new frame the best of several last hops is kept: from 1, 2, 4,
... frames before, whichever has accumulated the least squared error (as MFT does, Neoral et al. 2024, with a learned
uncertainty where we have the forward-backward error). A point hidden in between is found again by a longer hop
over its occlusion.

Errors are counted in units of a pixel of a frame whose longer side is 256, so that thresholds mean the same at any
resolution; positions are in pixels of the flow's raster.

Where no hop by flow ends on a visible place, a match by appearance may (`decomotion/data/links/matching.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from decomotion.data.flow.interface import Flow
from decomotion.data.sampling import bilinear
from decomotion.units import unit

if TYPE_CHECKING:  # it needs torch, which linking does not
    from decomotion.data.links.matching import Matches

Xy = npt.NDArray[np.float32]
FlowLookup = Callable[[int, int], Flow]
MatchLookup = Callable[[int, int], "Matches"]
RefineLookup = Callable[[int, int, Xy, Xy, tuple[int, ...]], Xy]

HOP_VARIANCE = 0.1**2
"""Squared error, in units^2, that every hop adds whatever its cycle error: prefers few hops to many."""
GAP_VARIANCE = 0.003
"""Squared error, in units^2 per squared gap, that a hop adds as well: flow is less exact over longer gaps."""
MATCH_VARIANCE = 0.3
"""Squared error, in units^2, that a hop by a match adds."""
CYCLE_SHARE = 0.3
"""Share of a hop's squared cycle error that is counted as its own squared error."""
CYCLE_LIMIT = 20.0
"""Cycle errors are counted up to here, in units."""
BYTES_A_POINT = 13
"""Of a point of one source frame in one frame that was reached; they are kept for the longest gap."""
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
    return np.linalg.norm(there + bilinear(backward, there) - xy, axis=-1)


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

    Yields: `Links` for each target frame that has sources, in the order of travel.
    """
    frames = len(points)
    order = range(frames) if step > 0 else range(frames - 1, -1, -1)
    longest = max(intervals + (rematching.intervals if rematching else ()))
    reached: dict[int, _State] = {}
    for target in order:
        best = None
        for origin, start in _starts(reached, target, intervals, max_gap, step):
            gap = abs(target - origin)
            best = _better(best, _hop(start, flow(origin, target), flow(target, origin), gap, cycle_threshold))
        if best is not None and rematching is not None:
            raster = flow(target, target - step).shape[:2]
            for origin, start in _starts(reached, target, rematching.intervals, max_gap, step):
                best = _found_again(best, start, origin, target, rematching, raster)
        own = _State(
            np.array([target]),
            points[target][None].astype(np.float32),
            np.zeros((1, points.shape[1]), np.float32),
            np.zeros((1, points.shape[1]), np.bool_),
        )
        if best is not None:
            yield Links(target, best.sources, best.xy, best.variance, best.occluded)
            own = best.joined(own)
        reached[target] = own
        for origin in [frame for frame in reached if abs(frame - target) >= longest]:
            del reached[origin]


@dataclass(frozen=True)
class _State:
    """The points of several source frames as they lie in one frame."""

    sources: npt.NDArray[np.int64]
    xy: Xy
    variance: npt.NDArray[np.float32]
    occluded: npt.NDArray[np.bool_]

    def keep(self, which: npt.NDArray[np.bool_]) -> _State:
        return _State(self.sources[which], self.xy[which], self.variance[which], self.occluded[which])

    def joined(self, other: _State) -> _State:
        return _State(
            np.concatenate([self.sources, other.sources]),
            np.concatenate([self.xy, other.xy]),
            np.concatenate([self.variance, other.variance]),
            np.concatenate([self.occluded, other.occluded]),
        )


def _starts(
    reached: dict[int, _State], target: int, intervals: tuple[int, ...], max_gap: int, step: int
) -> Iterator[tuple[int, _State]]:
    """The frames from which a hop over one of the gaps leads to the target, nearest first, with the points there."""
    for origin in (target - gap * step for gap in sorted(intervals) if gap <= max_gap):
        if origin in reached:
            yield origin, reached[origin].keep(np.abs(reached[origin].sources - target) <= max_gap)


def _hop(state: _State, forward: Flow, backward: Flow, gap: int, cycle_threshold: float) -> _State:
    there = state.xy + bilinear(forward, state.xy)
    height, width = forward.shape[:2]
    gone = outside(there, height, width)
    units = cycle_error(state.xy, there, backward) / unit(height, width)
    error = np.where(gone, CYCLE_LIMIT, units)
    variance = state.variance + HOP_VARIANCE + GAP_VARIANCE * gap**2 + CYCLE_SHARE * np.minimum(error, CYCLE_LIMIT) ** 2
    return _State(
        state.sources,
        there,
        variance.astype(np.float32),
        state.occluded | gone | (error > cycle_threshold),
    )


def _found_again(
    best: _State, start: _State, origin: int, target: int, rematching: Rematching, raster: tuple[int, ...]
) -> _State:
    """`best` with the points that a match from `start`, in frame `origin`, finds at less cost."""
    hop = _match_hop(start, rematching.match(origin, target), raster)
    cheaper = _cheaper(best, hop)
    if rematching.refine is not None:
        seen = cheaper & ~hop.occluded
        hop.xy[seen] = rematching.refine(origin, target, start.xy[seen], hop.xy[seen], raster)
    return _taken(best, hop, cheaper)


def _match_hop(state: _State, matches: Matches, raster: tuple[int, ...]) -> _State:
    """To where the cell that holds each point was matched, in pixels of a flow's `raster` (height, width)."""
    rows, columns = matches.trusted.shape
    pixels = np.array([raster[1] / columns, raster[0] / rows], np.float32)
    column, row = np.moveaxis(np.floor((state.xy + 0.5) / pixels).astype(np.int64), -1, 0)
    column, row = column.clip(0, columns - 1), row.clip(0, rows - 1)
    there = (state.xy + matches.displacement[row, column] * pixels).astype(np.float32)
    hidden = ~matches.trusted[row, column] | outside(there, raster[0], raster[1])
    return _State(state.sources, there, state.variance + np.float32(MATCH_VARIANCE), state.occluded | hidden)


def _better(best: _State | None, other: _State) -> _State:
    """Point by point the cheaper of two states."""
    if best is None:
        return other
    return _taken(best, other, _cheaper(best, other))


def _cheaper(best: _State, other: _State) -> npt.NDArray[np.bool_]:
    """Which points of `other` cost less than in `best`; it may lack the latest sources."""
    count = len(other.sources)
    return other.variance + OCCLUSION_COST * other.occluded < (
        best.variance[:count] + OCCLUSION_COST * best.occluded[:count]
    )


def _taken(best: _State, other: _State, cheaper: npt.NDArray[np.bool_]) -> _State:
    """`best` with the points of `other` that are `cheaper`."""
    count = len(other.sources)
    xy, variance, occluded = best.xy.copy(), best.variance.copy(), best.occluded.copy()
    xy[:count][cheaper] = other.xy[cheaper]
    variance[:count][cheaper] = other.variance[cheaper]
    occluded[:count][cheaper] = other.occluded[cheaper]
    return _State(best.sources, xy, variance, occluded)

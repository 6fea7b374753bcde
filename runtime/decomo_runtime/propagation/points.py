"""Keypoints and boxes carried from annotated frames to others: each frame asks the annotation it is seen best from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from decomo_runtime.propagation import disagreement
from decomo_runtime.regions import box_mask, region_queries

if TYPE_CHECKING:
    from decomo_runtime.tracker import Tracker

Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

ACROSS = 12
"""Points across the shorter side of a box."""
LEAST = 4
"""Points of a box in sight that its place is told by."""
HIDDEN = 1e6
"""Pixels of expected error that a hidden place costs: any that is in sight is preferred."""
OWNED = 0.25
"""Share of a box from which on what moves by itself in it is what the box is of."""


@dataclass(frozen=True, eq=False)
class Placed:
    """One object's points or box in M frames."""

    xy: Floats
    """[P, M, 2]; nan where it has no place."""
    occluded: Mask
    """[P, M]."""
    confidence: Floats
    """[M], from 0 to 1; 0 where there is no place."""
    in_sight: Floats
    """[M], share of its points in sight."""
    disagreement: Floats
    """[M], pixels between what two annotated frames say, the most of all pairs, in the mean over points; nan where no
    two have them in sight."""
    between: npt.NDArray[np.int64]
    """[M, 2], the two frames."""


def carry_points(tracker: Tracker, drawn: Mapping[int, tuple[Floats, Mask]], frames: npt.NDArray[np.int64]) -> Placed:
    """Points [P, 2] drawn in some frames, nan where one is not told, with which are hidden there [P].

    A hidden point is followed only where it is drawn in sight nowhere. The place in a frame is by the annotated frame
    from which the point is in sight with the least expected error. Out of the frame a point has no place.
    """
    count, length = len(next(iter(drawn.values()))[0]), len(frames)
    annotated = sorted(drawn)
    shape = (len(annotated), count, length)
    xy, cost = np.full((*shape, 2), np.nan), np.full(shape, np.inf)
    score, hidden = np.ones(shape), np.ones(shape, bool)
    seen_anywhere = np.any([np.isfinite(xy).all(axis=1) & ~occluded for xy, occluded in drawn.values()], axis=0)
    for row, frame in enumerate(annotated):
        places, occluded = drawn[frame]
        asked = np.flatnonzero(np.isfinite(places).all(axis=1) & ~(occluded & seen_anywhere))
        if not len(asked):
            continue
        queries = np.column_stack([np.full(len(asked), frame), places[asked]])
        tracks = tracker.track(queries, frames)
        error = np.abs(frames - frame)[None] if tracks.error is None else tracks.error
        xy[row, asked], score[row, asked], hidden[row, asked] = tracks.xy, tracks.occlusion, tracks.occluded
        cost[row, asked] = error + np.where(tracks.occluded, HIDDEN, 0)
    best = cost.argmin(axis=0)[None]
    chosen = np.take_along_axis(xy, best[..., None], axis=0)[0]
    occluded = np.take_along_axis(hidden, best, axis=0)[0]
    trust = 1 - np.take_along_axis(score, best, axis=0)[0]
    limit = np.array([tracker.width, tracker.height]) - 0.5
    gone = ~((chosen >= -0.5) & (chosen <= limit)).all(axis=-1)
    chosen[gone], occluded[gone], trust[gone] = np.nan, True, 0
    asked = np.isfinite(xy).all(axis=-1).any(axis=-1).any(axis=0)
    share = (~occluded[asked]).mean(axis=0) if asked.any() else np.zeros(length)
    confidence = trust[asked].mean(axis=0) if asked.any() else np.zeros(length)
    apart, between = _disagreement(annotated, xy, hidden)
    return Placed(chosen, occluded, confidence.clip(0, 1), share, apart, between)


def carry_box(tracker: Tracker, drawn: Mapping[int, Floats], frames: npt.NDArray[np.int64]) -> Placed:
    """A box, [2, 2] its upper left and lower right corner, drawn in some frames.

    It moves and scales as the points in it do that are in sight: those that move by themselves, if there are enough,
    else all. In a frame with too few it has no place. It is cut at the frame's borders.
    """
    annotated, length = sorted(drawn), len(frames)
    xy, cost = np.full((len(annotated), 2, length, 2), np.nan), np.full((len(annotated), length), np.inf)
    shares, trust = np.zeros((2, len(annotated), length))
    for row, frame in enumerate(annotated):
        box = drawn[frame]
        queries = _in_box(tracker, box, frame)
        tracks = tracker.track(queries, frames)
        error = np.broadcast_to(np.abs(frames - frame)[None], tracks.occluded.shape)
        error = error if tracks.error is None else tracks.error
        for column in range(length):
            seen = ~tracks.occluded[:, column]
            if seen.sum() < min(LEAST, len(queries)):
                continue
            xy[row, :, column] = _moved(box, queries[seen, 1:], tracks.xy[seen, column].astype(np.float64))
            shares[row, column] = seen.mean()
            trust[row, column] = (1 - tracks.occlusion[:, column]).mean()
            cost[row, column] = np.median(error[seen, column]) / shares[row, column]
    best, columns = cost.argmin(axis=0), np.arange(length)
    limit = np.array([tracker.width, tracker.height]) - 0.5
    placed = xy[best, :, columns].swapaxes(0, 1).clip(-0.5, limit)  # [2, M, 2]
    gone = ~(placed[1] > placed[0]).all(axis=-1)
    placed[:, gone] = np.nan
    share, confidence = (np.where(gone, 0, each[best, columns]) for each in (shares, trust))
    apart, between = _disagreement(annotated, xy, np.isnan(xy[..., 0]))
    return Placed(placed, np.repeat(gone[None], 2, axis=0), confidence.clip(0, 1), share, apart, between)


def _in_box(tracker: Tracker, box: Floats, frame: int) -> Floats:
    """[N, 3] rows of (t, x, y)."""
    inside = box_mask(box, (tracker.height, tracker.width))
    queries = region_queries(inside, frame, max(1.0, float((box[1] - box[0]).min()) / ACROSS))
    own = tracker.on_object(queries)
    return queries[own] if own.mean() >= OWNED and own.sum() >= LEAST else queries


def _moved(box: Floats, here: Floats, there: Floats) -> Floats:
    """The box [2, 2], moved and scaled in each axis as the points are, in the median."""
    moved = box.copy()
    for axis in (0, 1):
        old, new = here[:, axis], there[:, axis]
        middle, centre = np.median(old), np.median(new)
        spread, wide = np.median(np.abs(old - middle)), np.median(np.abs(new - centre))
        scale = wide / spread if spread >= 1 else 1.0
        moved[:, axis] = centre + scale * (box[:, axis] - middle)
    return moved


def _disagreement(annotated: list[int], xy: Floats, hidden: Mask) -> tuple[Floats, npt.NDArray[np.int64]]:
    """[M] and [M, 2] of `Placed`, from [annotated, P, M, 2] and [annotated, P, M]."""
    apart, pairs = disagreement.of_points(xy, hidden)
    return apart, np.where(pairs < 0, -1, np.array(annotated)[pairs])

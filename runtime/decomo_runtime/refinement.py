"""Tracks at the clip's own precision: each answer in sight is registered on the pixels of the clip.

A model is fitted to flow on frames of at most 640 pixels on the longer side, and knows a point of a large frame to
several pixels. Here the patch around the point, as the query's frame shows it, is sought in every frame around the
model's answer, warped by the model's own Jacobian (`registration.py`). Where it is not found, what the nearest frame
showed in which it was found is sought instead; the deviations then add up, so that drift stays within what one match
may deviate.

A match counts only where it is plain that it is better than the model's answer: patch and frame are alike, noise
cannot have moved it far, and it leaves a fraction of the difference that the model's answer leaves. Everything else
stays as the model has it: what is occluded, smooth places, surfaces that change.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Protocol

import cv2
import numpy as np
import numpy.typing as npt

from decomo_runtime.errors import RefinementError
from decomo_runtime.expected_error import refined_error
from decomo_runtime.footage import check_footage
from decomo_runtime.model_file import ModelFacts
from decomo_runtime.queries import check_frames, check_queries
from decomo_runtime.registration import (
    OFFSETS,
    RADIUS,
    SIDE,
    WINDOW,
    Match,
    Patches,
    Pyramid,
    cut,
    empty_patches,
    judge,
    pyramid,
    register,
)
from decomo_runtime.tracks import Tracks
from decomotion.frames import AnyFrames
from decomotion.units import unit

Floats = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]
Rows = npt.NDArray[np.intp]

FARTHEST = 2.0
"""Units by which a model's answer may err; what is found farther away is something else."""
LARGEST_DEVIATION = 0.25
"""Pixels by which noise may have moved a place."""
BETTER = 4.0
"""Of a frame's variance a match leaves so many times less unexplained than the model's answer. Fur, water and moving
light leave much at any place: there a little less is no sign of a better one.
"""
OWNED = 3
"""Pixels of a patch, along and across, of which one is asked whose it is; a part of its side."""
CHUNK = 4096
"""Points at once; the clip is read once for each chunk, and once more for frames before a query's."""
BLOCK = 8
"""Frames that are read in their order to be used in the opposite one."""


class AnyTracker(Protocol):
    """What is asked of a `Tracker`."""

    @property
    def facts(self) -> ModelFacts:
        """Of the clip and its model."""
        ...

    def track(self, queries: npt.ArrayLike, frames: npt.ArrayLike | None = None) -> Tracks:
        """Follows `queries` [N, 3] to `frames` [M]."""
        ...

    def on_object(self, queries: npt.ArrayLike) -> Mask:
        """Which of `queries` [N, 3] a moving object owns."""
        ...


def refine(tracker: AnyTracker, tracks: Tracks, frames: AnyFrames) -> Tracks:
    """`tracks` with what is found of them in `frames` (RGB, uint8 [T, H, W, 3], of the whole clip), and `refined` set.

    Occlusion stays as it is; the expected error shrinks where a point is found. One point's answer does not depend on
    the others; frames that are not asked for are not read, except those of the queries. Raises `RefinementError` where
    frames or tracks are not of the tracker's clip.
    """
    model = tracker.facts
    check_footage(frames, model, RefinementError)
    if tracks.size not in (None, (model.height, model.width)):
        raise RefinementError(
            f"the tracks are of frames of {tracks.size[1]}x{tracks.size[0]} but {model.clip_name} has frames of "
            f"{model.width}x{model.height}; give tracks of this model"
        )
    check_queries(tracks.queries, model)
    check_frames(tracks.frames, model.num_frames)
    xy, refined = tracks.xy.copy(), np.zeros_like(tracks.occluded)
    for begin in range(0, len(xy), CHUNK):
        rows = slice(begin, begin + CHUNK)
        search = _Search(tracker, tracks.queries[rows], tracks.frames, tracks.xy[rows], ~tracks.occluded[rows], frames)
        xy[rows], refined[rows] = search.run()
    error = None if tracks.error is None else refined_error(tracks.error, refined)
    return replace(tracks, xy=xy, refined=refined, error=error)


class _Search:
    """The search for N points in M frames.

    Args:
        tracker: the model.
        queries: [N, 3], (t, x, y).
        numbers: [M], of the frames.
        answers: [N, M, 2], the model's.
        seen: [N, M], where it says that the points are in sight.
        frames: of the whole clip.
    """

    def __init__(
        self,
        tracker: AnyTracker,
        queries: Floats,
        numbers: npt.NDArray[np.int64],
        answers: Floats,
        seen: Mask,
        frames: AnyFrames,
    ) -> None:
        height, width = tracker.facts.height, tracker.facts.width
        size, scale = np.array([width, height], np.float32), unit(height, width)
        self._tracker, self._frames, self._numbers, self._answers = tracker, frames, numbers, answers
        self._asked_in, self._places = queries[:, 0].astype(np.int64), queries[:, 1:]
        self._farthest = FARTHEST * scale
        self._levels = 1 + max(0, round(math.log2(scale / 2)))  # an error of two units is four pixels of the coarsest
        self._matrix = _jacobian(tracker, queries, numbers, answers, max(scale, RADIUS), size)
        inside = ((answers > -0.5) & (answers < size - 0.5)).all(-1)
        self._sought = seen & inside
        self._xy, self._found = answers.copy(), np.zeros_like(seen)

    def run(self) -> tuple[Floats, Mask]:
        """Places [N, M, 2], and where [N, M] they were found: the others are the model's answers."""
        at_query = self._asked_in[:, None] == self._numbers
        here = np.nonzero(at_query & self._sought)
        self._xy[here], self._found[here] = self._places[here[0]], True
        asked = self._ask()
        order = np.argsort(self._numbers, kind="stable")
        later = self._asked_in[:, None] < self._numbers
        self._follow(asked, order, self._sought & later)
        self._follow(asked, order[::-1], self._sought & ~later & ~at_query)
        return self._xy, self._found

    def _ask(self) -> Patches:
        """The patches of the queries; of what the model knows to be another's, nothing."""
        patches = empty_patches(len(self._places), self._levels)
        for frame in np.unique(self._asked_in[self._sought.any(1)]):
            rows = np.flatnonzero(self._asked_in == frame)
            upright = np.broadcast_to(np.eye(2, dtype=np.float32), (len(rows), 2, 2))
            weights = WINDOW * self._own(rows)
            patches[rows] = cut(self._pyramid(self._frames[int(frame)]), self._places[rows], upright, weights)
        return patches

    def _own(self, rows: Rows) -> Mask:
        """[n, l, p]: which pixels of each level's patch belong to what the point belongs to."""
        edge = np.array([self._tracker.facts.width, self._tracker.facts.height], np.float32) - 0.5
        along = SIDE // OWNED
        steps = OFFSETS.reshape(along, OWNED, along, OWNED, 2)[:, OWNED // 2, :, OWNED // 2]
        around = np.stack([2**level * steps for level in range(self._levels)])
        places = np.clip(self._places[rows, None, None, None] + around, -0.5, edge).reshape(-1, 2)
        t = np.repeat(self._asked_in[rows], len(places) // max(1, len(rows)))
        owned = self._tracker.on_object(np.column_stack([t, places])).reshape(len(rows), self._levels, along, along)
        own = owned == owned[:, :1, along // 2, along // 2, None, None]
        return own.repeat(OWNED, 2).repeat(OWNED, 3).reshape(len(rows), self._levels, -1)

    def _follow(self, asked: Patches, order: Rows, sought: Mask) -> None:
        """Seeks points where `sought` [N, M], in frames by `order`, which leads away from the queries' frames.

        First where the point would be if the model erred as it did before, which is quick; then all around the model's
        answer; at last what was found before instead of the query.
        """
        trail = _Trail.begun(*asked.weights.shape[:2])
        for column, images in self._pictures(order[sought[:, order].any(0)]):
            rows = np.flatnonzero(sought[:, column])
            shift, exact = trail.shift.copy(), np.zeros(len(sought), np.float32)
            rows = self._seek(rows, column, images, asked, exact, trail, shift, 1)
            rows = self._seek(rows, column, images, asked, exact, trail, np.zeros_like(shift), self._levels)
            rows = rows[np.isfinite(trail.deviation[rows])]
            self._seek(rows, column, images, trail.patches, trail.deviation.copy(), trail, shift, 1)
            found = np.flatnonzero(self._found[:, column] & sought[:, column])
            if len(found):
                places, matrix = self._xy[found, column], self._matrix[found, column]
                trail.patches[found] = cut(images, places, matrix, asked.weights[found])

    def _seek(
        self,
        rows: Rows,
        column: int,
        images: Pyramid,
        patches: Patches,
        drift: Floats,
        trail: _Trail,
        shift: Floats,
        levels: int,
    ) -> Rows:
        """Seeks `patches` that have drifted by `drift` [N], from the model's answers and `shift` [N, 2] on: the rows
        that are not found.
        """
        wanted, answer, matrix = patches[rows], self._answers[rows, column], self._matrix[rows, column]
        match = register(wanted, images, answer + shift[rows], matrix, levels)
        match = replace(match, deviation=match.deviation + drift[rows])
        good = self._is_plain(match, judge(wanted, images, answer, matrix))
        found = rows[good]
        self._xy[found, column], self._found[found, column] = match.xy[good], True
        trail.deviation[found], trail.shift[found] = match.deviation[good], match.xy[good] - answer[good]
        return rows[~good]

    def _is_plain(self, match: Match, answer: Match) -> Mask:
        """Whether the match is plainly better than the model's answer."""
        return (
            (BETTER * match.unexplained < answer.unexplained)
            & (match.deviation < LARGEST_DEVIATION)
            & (np.hypot(*(match.xy - answer.xy).T) < self._farthest)
        )

    def _pictures(self, columns: Rows) -> Iterator[tuple[int, Pyramid]]:
        """The frames of `columns` in that order; where they run backwards, they are read forwards in blocks."""
        backwards = len(columns) > 1 and self._numbers[columns[0]] > self._numbers[columns[-1]]
        size = BLOCK if backwards else 1
        for begin in range(0, len(columns), size):
            block = columns[begin : begin + size]
            read = [self._frames[int(self._numbers[column])] for column in block[::-1]]
            for column in block:
                yield int(column), self._pyramid(read.pop())

    def _pyramid(self, frame: npt.NDArray[np.uint8]) -> Pyramid:
        return pyramid(np.asarray(cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY), np.uint8), self._levels)


@dataclass(frozen=True, eq=False)
class _Trail:
    """Of N points, the nearest frame before in which they were found; at first none."""

    patches: Patches
    """What it shows."""
    shift: Floats
    """[N, 2], from the model's answer to where they were found."""
    deviation: Floats
    """[N], pixels by which noise may have moved that; infinite at first."""

    @staticmethod
    def begun(points: int, levels: int) -> _Trail:
        return _Trail(
            empty_patches(points, levels), np.zeros((points, 2), np.float32), np.full(points, np.inf, np.float32)
        )


def _jacobian(
    tracker: AnyTracker, queries: Floats, numbers: npt.NDArray[np.int64], answers: Floats, apart: float, size: Floats
) -> Floats:
    """[N, M, 2, 2]: how the model moves what lies around each query, from its answers to points `apart` from it."""
    apart = min(apart, float(size.min()) / 2)
    matrix = np.empty((*answers.shape, 2), np.float32)
    for axis in range(2):
        side = np.where(queries[:, 1 + axis] + apart > size[axis] - 0.5, -apart, apart).astype(np.float32)
        beside = queries.copy()
        beside[:, 1 + axis] += side
        matrix[..., axis] = (tracker.track(beside, numbers).xy - answers) / side[:, None, None]
    return matrix

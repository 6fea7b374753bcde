"""How points go on from window to window of a long clip.

A point is followed by the model of the window in which its query lies farther from either end. It leaves for the next
window at the frame of those that both share where it is surest to be seen: the place where one model sees it there is
asked of the other. A point that is hidden in all of them may come back: what the next model has hidden in the same
place, and sees later, is taken for it (`returning.py`). One that does not come back stays where it was last, hidden,
and so does every point at a cut.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from decomo_runtime.windows import WindowModels

FORWARD, BACKWARD = 1, -1
OFF_CENTRE = 0.02
"""By how much more occluded a point may be in the middle of the shared frames than at their ends, and yet cross there.
"""

Floats = npt.NDArray[np.float32]
Rows = npt.NDArray[np.int64]


@dataclass(frozen=True)
class _Points:
    """Some of the points, as they are in one window."""

    rows: Rows
    """[n], which they are."""
    queries: Floats
    """[n, 3], by what the window's model is asked for them, (t, x, y) of the clip."""
    since: Rows
    """[n], the frame beyond which they are this window's."""

    def of(self, chosen: npt.NDArray) -> _Points:
        return _Points(self.rows[chosen], self.queries[chosen], self.since[chosen])


def _joined(parts: Sequence[_Points]) -> _Points:
    return _Points(*(np.concatenate([getattr(part, name) for part in parts]) for name in _Points.__annotations__))


def follow(
    models: WindowModels,
    queries: Floats,
    frames: npt.NDArray[np.int64],
    chunk: int | None = None,
    max_memory: int | None = None,
) -> tuple[Floats, Floats]:
    """Places [N, M, 2] in pixels and occlusion [N, M] of `queries` [N, 3] in `frames` [M] of the clip."""
    if len(models) == 1:
        return models[0].track(queries, frames, chunk, max_memory)
    return _Journey(models, queries, frames, chunk, max_memory).run()


class _Journey:
    """Leads points through the windows.

    Args:
        models: of the windows.
        queries: [N, 3], (t, x, y) of the clip.
        frames: [M], of the clip, in which places are wanted.
        chunk: as of `Model.track`, and so is `max_memory`.
    """

    def __init__(
        self,
        models: WindowModels,
        queries: Floats,
        frames: npt.NDArray[np.int64],
        chunk: int | None,
        max_memory: int | None,
    ) -> None:
        self._models, self._layout, self._queries, self._frames = models, models.layout, queries, frames
        self._memory = chunk, max_memory
        self._entering: dict[tuple[int, int], list[_Points]] = {}
        self._xy = np.empty((len(queries), len(frames), 2), np.float32)
        self._occlusion = np.ones((len(queries), len(frames)), np.float32)

    def run(self) -> tuple[Floats, Floats]:
        """Places [N, M, 2] in pixels and occlusion [N, M]."""
        for number, rows in self._models.by_window(self._queries):
            start = self._queries[rows]
            self._visit(number, _Points(rows, start, start[:, 0].astype(np.int64)), FORWARD, BACKWARD)
        for step in (FORWARD, BACKWARD):
            for number in range(len(self._models))[::step]:
                parts = self._entering.pop((number, step), [])
                if parts:
                    self._visit(number, _joined(parts), step)
        return self._xy, self._occlusion

    def _visit(self, number: int, points: _Points, *steps: int) -> None:
        """Follows points through a window, from where they come in, in the directions `steps`."""
        window = self._layout.windows[number]
        wanted = (self._frames >= window.begin) & (self._frames < window.end)
        if len(steps) == 1:  # what lies behind is answered
            first = (steps[0] * points.since).min() * steps[0]
            wanted &= steps[0] * (self._frames - first) > 0
        columns = np.flatnonzero(wanted)
        onward = {step: np.array(self._onward(number, step), np.int64) for step in steps}
        asked = np.unique(np.concatenate([self._frames[columns], *onward.values()]))
        if not len(asked):
            return
        start = points.queries - np.array([window.begin, 0, 0], np.float32)
        xy, occlusion = self._models[number].track(start, asked - window.begin, *self._memory)
        ahead = np.ones((len(points.rows), len(columns)), bool)
        if len(steps) == 1:
            ahead = steps[0] * (self._frames[columns] - points.since[:, None]) > 0
        row, column = np.nonzero(ahead)
        answer = np.searchsorted(asked, self._frames[columns])[column]
        self._xy[points.rows[row], columns[column]] = xy[row, answer]
        self._occlusion[points.rows[row], columns[column]] = occlusion[row, answer]
        for step, frames in onward.items():
            if len(frames):
                places = np.searchsorted(asked, frames)
                self._leave(number, step, points, frames, xy[:, places], occlusion[:, places])

    def _leave(self, number: int, step: int, points: _Points, frames: Rows, xy: Floats, occlusion: Floats) -> None:
        """Sends points on to the next window, from where they are in its shared `frames`, xy [n, f, 2]."""
        every = np.arange(len(points.rows))
        if not self._shared(number, step):
            self._stay(points.rows, frames[0], step, xy[:, 0])
            return
        behind = step * (frames - points.since[:, None]) < 0
        chosen = _surest(occlusion, behind)
        seen = occlusion[every, chosen] <= self._models.facts.occlusion_threshold
        entry = np.column_stack([frames[chosen], xy[every, chosen]]).astype(np.float32)
        crossing = _Points(points.rows, entry, frames[chosen])
        self._enter(number + step, step, crossing.of(seen))
        lost = np.flatnonzero(~seen)
        if not len(lost):
            return
        returning = self._models.returning(number + step, step)
        place = xy[lost, np.searchsorted(frames, returning.frame)]
        on_object = self._on_object(points.rows[lost])
        found, queries = returning.find(place, on_object)
        back = _Points(points.rows[lost], queries, np.full(len(lost), returning.frame))
        self._enter(number + step, step, back.of(found))
        self._stay(points.rows[lost[~found]], returning.frame, step, place[~found])

    def _enter(self, number: int, step: int, points: _Points) -> None:
        if len(points.rows):
            self._entering.setdefault((number, step), []).append(points)

    def _stay(self, rows: Rows, frame: int, step: int, place: Floats) -> None:
        """Beyond `frame` points are hidden where they were in it, `place` [n, 2]."""
        beyond = np.flatnonzero(step * (self._frames - frame) > 0)
        self._xy[rows[:, None], beyond] = place[:, None]
        self._occlusion[rows[:, None], beyond] = 1

    def _on_object(self, rows: Rows) -> npt.NDArray[np.bool_]:
        """Whether a moving object owns points where their queries are."""
        return self._models.sample(self._queries[rows], *self._memory).on_object(self._models.facts.object_share)

    def _onward(self, number: int, step: int) -> range:
        """The frames in which a point may leave for the next window; at a cut the last one; empty where none is wanted.

        Frames beyond the first of them are answered by the next window, whatever else is asked for.
        """
        if not 0 <= number + step < len(self._models):
            return range(0)
        window = self._layout.windows[number]
        last = window.end - 1 if step > 0 else window.begin
        shared = self._shared(number, step) or range(last, last + 1)
        first = shared[0] if step > 0 else shared[-1]
        return shared if (step * (self._frames - first) > 0).any() else range(0)

    def _shared(self, number: int, step: int) -> range:
        return self._layout.shared(number if step > 0 else number - 1)


def _surest(occlusion: Floats, behind: npt.NDArray[np.bool_]) -> Rows:
    """[n]: in which of the shared frames, in order, each point is surest to be seen by its `occlusion` [n, frame].

    Not in frames that lie `behind` it; of nearly equal ones, in that which is farther from either end.
    """
    places = np.arange(occlusion.shape[1])
    off_centre = np.abs(places - places.mean()) / max(1, len(places))
    return np.where(behind, np.inf, occlusion + OFF_CENTRE * off_centre).argmin(axis=1)

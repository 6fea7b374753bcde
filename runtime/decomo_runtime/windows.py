"""The models of a clip's windows (`decomotion/windows.py`), and how a point goes on from one to the next.

A point is followed by the model of the window in which its query lies farther from either end. It leaves for the next
window at the frame of those that both share where it is surest to be seen: the place where one model sees it there is
asked of the other. A point that is hidden in all of them crosses where it is the least so, and takes up what is seen in
that place. Across a cut nothing can be followed: a point stays where it was last, hidden.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from decomo_runtime.errors import ModelFileError
from decomo_runtime.model import Appearance, Model
from decomo_runtime.model_file import ModelFacts
from decomotion.quality import Quality
from decomotion.windows import FILE_NAME, Window, Windows

MOST_OPEN = 8
"""Models that are kept open at a time."""
FORWARD, BACKWARD = 1, -1
OFF_CENTRE = 0.02
"""By how much more occluded a point may be in the middle of the shared frames than at their ends, and yet cross there.
"""

Floats = npt.NDArray[np.float32]
Rows = npt.NDArray[np.int64]
Open = Callable[[Path], Model]


class WindowModels:
    """The models of all windows of a clip, opened when asked for. Threads may share it.

    Args:
        path: an .onnx file, which is the one window of its clip, or a folder with `windows.json` and a file for each.
        opened: opens one.

    Raises `ModelFileError` where a file is missing or is none, or they contradict each other.
    """

    def __init__(self, path: Path, opened: Open) -> None:
        self._opened, self._lock = opened, threading.Lock()
        self._models: OrderedDict[int, Model] = OrderedDict()
        if not path.is_dir():
            model = opened(path)
            self.facts, self._files = model.facts, [path]
            self._models[0] = model
            times = self.facts.times
            self.layout = Windows(
                self.facts.clip_name,
                self.facts.num_frames,
                self.facts.height,
                self.facts.width,
                self.facts.fps,
                (Window(path.stem, 0, self.facts.num_frames),),
                times,
                self.facts.pixel_aspect,
            )
            return
        if not (path / FILE_NAME).is_file():
            raise ModelFileError(f"{path} is a folder without {FILE_NAME}; give the .onnx file inside it")
        self.layout = Windows.load(path / FILE_NAME, ModelFileError)
        self._files = [path / f"{window.name}.onnx" for window in self.layout.windows]
        missing = [file.name for file in self._files if not file.is_file()]
        if missing:
            raise ModelFileError(
                f"{path} lacks {', '.join(missing)}; copy the whole folder again, or write it with 'decomo-export'"
            )
        self.facts = replace(
            self[0].facts,
            clip_name=self.layout.clip,
            num_frames=self.layout.num_frames,
            fps=self.layout.fps,
            times=self.layout.seconds,
            pixel_aspect=self.layout.pixel_aspect,
            quality=_worst(self.layout.quality or ()),
        )

    def __len__(self) -> int:
        return len(self._files)

    def __getitem__(self, number: int) -> Model:
        with self._lock:
            if number not in self._models:
                model = self._opened(self._files[number])
                self._check(number, model.facts)
                self._models[number] = model
                if len(self._models) > MOST_OPEN:
                    self._models.popitem(last=False)
            self._models.move_to_end(number)
            return self._models[number]

    def _check(self, number: int, facts: ModelFacts) -> None:
        found = facts.num_frames, facts.height, facts.width
        if found != (len(self.layout.windows[number]), self.layout.height, self.layout.width):
            file = self._files[number]
            raise ModelFileError(
                f"{file} is of {found[0]} frames of {found[2]}x{found[1]}, and {file.with_name(FILE_NAME)} says "
                "otherwise; export the run again"
            )

    def sample(self, queries: Floats, chunk: int | None = None, max_memory: int | None = None) -> Appearance:
        """What the models see along the rays of `queries` [N, 3], each in its own window."""
        if len(self) == 1:
            return self[0].sample(queries, chunk, max_memory)
        whole = Appearance(*np.empty((3, len(queries), 3), np.float32), *np.empty((3, len(queries)), np.float32))
        for number, rows in self._by_window(queries):
            begin = self.layout.windows[number].begin
            part = self[number].sample(queries[rows] - np.array([begin, 0, 0], np.float32), chunk, max_memory)
            for name in Appearance.__dataclass_fields__:
                getattr(whole, name)[rows] = getattr(part, name)
        return whole

    def track(
        self, queries: Floats, frames: npt.NDArray[np.int64], chunk: int | None = None, max_memory: int | None = None
    ) -> tuple[Floats, Floats]:
        """Places [N, M, 2] in pixels and occlusion [N, M] of `queries` [N, 3] in `frames` [M] of the clip."""
        if len(self) == 1:
            return self[0].track(queries, frames, chunk, max_memory)
        journey = _Journey(self, frames, len(queries), chunk, max_memory)
        for number, rows in self._by_window(queries):
            journey.visit(number, rows, queries[rows], FORWARD, BACKWARD)
        for step in (FORWARD, BACKWARD):
            for number in range(len(self))[::step]:
                journey.go_on(number, step)
        return journey.xy, journey.occlusion

    def _by_window(self, queries: Floats) -> Iterable[tuple[int, Rows]]:
        """Each window that is the home of some queries, and their rows."""
        home = self.layout.home(queries[:, 0].astype(np.int64))
        return [(int(number), np.flatnonzero(home == number)) for number in np.unique(home)]


def _worst(qualities: Iterable[Quality | None]) -> Quality | None:
    """Of the windows that tell, the one whose held-out links are missed the most in the median."""
    return max((each for each in qualities if each is not None), key=lambda each: each.all.median, default=None)


class _Journey:
    """Points on their way from window to window: where they have been, and where they enter the next."""

    def __init__(
        self,
        models: WindowModels,
        frames: npt.NDArray[np.int64],
        points: int,
        chunk: int | None,
        max_memory: int | None,
    ) -> None:
        self._models, self._layout, self._frames = models, models.layout, frames
        self._memory = chunk, max_memory
        self._entering: dict[tuple[int, int], list[tuple[Rows, Floats]]] = {}
        self.xy = np.empty((points, len(frames), 2), np.float32)
        self.occlusion = np.ones((points, len(frames)), np.float32)

    def go_on(self, number: int, step: int) -> None:
        """Follows all points that enter a window from the one before it in the direction `step`."""
        parts = self._entering.pop((number, step), [])
        if parts:
            rows, begun = (np.concatenate(each) for each in zip(*parts, strict=True))
            self.visit(number, rows, begun, step)

    def visit(self, number: int, rows: Rows, begun: Floats, *steps: int) -> None:
        """Follows points `rows` from where they are, `begun` [n, 3], through a window, in the directions `steps`."""
        window = self._layout.windows[number]
        wanted = (self._frames >= window.begin) & (self._frames < window.end)
        onward = {step: self._onward(number, step) for step in steps}
        if len(steps) == 1:  # what lies behind is answered
            wanted &= steps[0] * (self._frames - (begun[:, 0] * steps[0]).min() * steps[0]) > 0
        columns = np.flatnonzero(wanted)
        asked = np.unique(np.concatenate([self._frames[columns], *(np.array(each) for each in onward.values())]))
        asked = asked.astype(np.int64)
        if not len(asked):
            return
        there, hidden = self._models[number].track(
            begun - np.array([window.begin, 0, 0], np.float32), asked - window.begin, *self._memory
        )
        ahead = np.ones((len(rows), len(columns)), bool)
        if len(steps) == 1:
            ahead = steps[0] * (self._frames[columns] - begun[:, :1]) > 0
        row, column = np.nonzero(ahead)
        answer = np.searchsorted(asked, self._frames[columns])[column]
        self.xy[rows[row], columns[column]] = there[row, answer]
        self.occlusion[rows[row], columns[column]] = hidden[row, answer]
        for step, frames in onward.items():
            if not len(frames):
                continue
            places = np.searchsorted(asked, np.array(frames))
            if self._shared(number, step):
                chosen = places[_surest(hidden[:, places], step * (asked[places] - begun[:, :1]) < 0)]
                entry = np.column_stack([asked[chosen], there[np.arange(len(rows)), chosen]]).astype(np.float32)
                self._entering.setdefault((number + step, step), []).append((rows, entry))
            else:
                beyond = np.flatnonzero(step * (self._frames - frames[0]) > 0)
                self.xy[rows[:, None], beyond] = there[:, places]

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


def _surest(hidden: Floats, behind: npt.NDArray[np.bool_]) -> Rows:
    """[n]: in which of the shared frames, in order, each point is surest to be seen by its occlusion [n, frame].

    Not in frames that lie `behind` it; of nearly equal ones, in that which is farther from either end.
    """
    places = np.arange(hidden.shape[1])
    off_centre = np.abs(places - places.mean()) / max(1, len(places))
    return np.where(behind, np.inf, hidden + OFF_CENTRE * off_centre).argmin(axis=1)

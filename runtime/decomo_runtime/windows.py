"""The models of a clip's windows (`decomotion/windows.py`), opened when asked for."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from decomo_runtime.errors import ModelFileError
from decomo_runtime.model import Appearance, Model
from decomo_runtime.model_file import ModelFacts
from decomotion.quality import worst
from decomotion.windows import FILE_NAME, Window, Windows

if TYPE_CHECKING:
    from decomo_runtime.card import Card
    from decomo_runtime.returning import Returning

MOST_OPEN = 8
"""Models that are kept open at a time."""
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
        self._returning: dict[tuple[int, int], Returning] = {}
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
            raise ModelFileError(
                f"{path} is a folder without {FILE_NAME}; give what decomo-export wrote: an .onnx file, or the folder "
                "of a clip of several windows"
            )
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
            quality=worst(self.layout.quality or ()),
        )

    def __len__(self) -> int:
        return len(self._files)

    def card(self, path: Path) -> Card:
        """What the models say about themselves; `path` is what the user gave."""
        from decomo_runtime.card import Card, window_cards

        layout, facts = self.layout, self.facts
        qualities = (facts.quality,) if len(self) == 1 else layout.quality or (None,) * len(self)
        windows = window_cards(self._files, [(each.begin, each.end) for each in layout.windows], qualities)
        return Card(
            path=path,
            bytes=sum(each.bytes for each in windows),
            clip_name=facts.clip_name,
            num_frames=facts.num_frames,
            height=facts.height,
            width=facts.width,
            fps=facts.fps,
            seconds=float(layout.times[-1]) + 1 / facts.fps,
            pixel_aspect=facts.pixel_aspect,
            windows=windows,
            preset=facts.preset,
            origin=facts.origin,
            quality=facts.quality,
            providers=self[0].providers,
        )

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
        for number, rows in self.by_window(queries):
            begin = self.layout.windows[number].begin
            part = self[number].sample(queries[rows] - np.array([begin, 0, 0], np.float32), chunk, max_memory)
            for name in Appearance.__dataclass_fields__:
                getattr(whole, name)[rows] = getattr(part, name)
        return whole

    def returning(self, number: int, step: int) -> Returning:
        """What window `number` has hidden in the middle of the frames that it shares with the one behind it.

        `step` is the direction in time in which it is entered.
        """
        from decomo_runtime.returning import Returning  # OpenCV, which only such points need

        key = number, step
        with self._lock:
            if key not in self._returning:
                shared = self.layout.shared(number - 1 if step > 0 else number)
                begin = self.layout.windows[number].begin
                self._returning[key] = Returning(lambda: self[number], begin, shared[len(shared) // 2])
            return self._returning[key]

    def by_window(self, queries: Floats) -> Iterable[tuple[int, Rows]]:
        """Each window that is the home of some queries, and their rows."""
        home = self.layout.home(queries[:, 0].astype(np.int64))
        return [(int(number), np.flatnonzero(home == number)) for number in np.unique(home)]

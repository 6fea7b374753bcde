"""Tracks: the answer to a set of queries; `formats/` has the files that hold it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from decomo_runtime.errors import QueryError
from decomo_runtime.formats.about import About


@dataclass(frozen=True, eq=False, repr=False)
class Tracks:
    """Where N query points are in M frames."""

    xy: npt.NDArray[np.float32]
    """[N, M, 2], (x, y) in pixels of the clip; outside of the frame where the point has left it."""
    occluded: npt.NDArray[np.bool_]
    """[N, M], True where the score is above the model's threshold."""
    occlusion: npt.NDArray[np.float32]
    """[N, M], score from 0 (surely in sight) to 1 (surely hidden)."""
    queries: npt.NDArray[np.float32]
    """[N, 3], (t, x, y)."""
    frames: npt.NDArray[np.int64]
    """[M], the frame number of each column."""
    size: tuple[int, int] | None = None
    """(height, width) of the clip in pixels; None where a file does not say."""
    times: npt.NDArray[np.float64] | None = None
    """[M], seconds of each column's frame from the clip's first; None where a file does not say."""
    refined: npt.NDArray[np.bool_] | None = None
    """[N, M], True where the place was found in the clip's own pixels (`Tracker.refine`) and is not the model's answer;
    None where nothing was sought."""
    error: npt.NDArray[np.float32] | None = None
    """[N, M], expected error in pixels of the clip: four of five answers are within it (`expected_error.py`); 0 at the
    query. None where a file does not say."""

    def __repr__(self) -> str:
        number, length = self.occluded.shape
        size = "" if self.size is None else f" of {self.size[1]}x{self.size[0]}"
        hidden = f", {self.occluded.mean():.0%} occluded" if self.occluded.size else ""
        return f"Tracks({number} point{'s' * (number != 1)} in {length} frame{'s' * (length != 1)}{size}{hidden})"

    def within(self, max_error: float) -> Tracks:
        """The same tracks, with answers marked hidden that may be farther off than `max_error` pixels, or whose
        error is not a number.

        Raises `QueryError` where the error is not known, or `max_error` is not above 0.
        """
        if not max_error > 0:
            raise QueryError(f"an error of {max_error:g} pixels is none to ask for; give one above 0")
        if self.error is None:
            raise QueryError("these tracks do not say how far off they may be; ask the model again")
        return replace(self, occluded=self.occluded | ~(self.error <= max_error))

    def save(self, path: str | Path, to: str | None = None, *, about: About | None = None) -> None:
        """Writes `path`, whole or not at all, in the format `to`, or in the one that its ending means.

        docs/formats.md has npz and csv, docs/convert.md all formats; `about` is what some want to know beside.
        `TracksFileError` where there is no such format, or it cannot hold these tracks.
        """
        _registry().format_of(Path(path), to).write(self, Path(path), about or About())

    @classmethod
    def load(cls, path: str | Path) -> Tracks:
        """Reads an npz, csv or JSON that `save` or the page wrote, or an npz of the same keys.

        A csv has no line for a point without frames, four decimals, and nothing of the clip's size. `TracksFileError`
        where it is another file.
        """
        return _registry().read(Path(path))[0]


def _registry() -> Any:
    """By its name: formats are made of `Tracks`."""
    return import_module("decomo_runtime.formats.registry")

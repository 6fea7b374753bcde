"""What decoding a video from its first frame on has met, by which frames are found again; kept in the cache.

A part of a video that was opened before, as a window of a long one, is so opened without decoding what lies before it.
Kept is only what leaves nothing in doubt: frames of one size, none lost, at rising times that the file itself says.
"""

from __future__ import annotations

import hashlib
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from decomotion.arrays import read_npz
from decomotion.cache import cache_root
from decomotion.decoding import Display, mark
from decomotion.errors import ClipError
from decomotion.files import replacing
from decomotion.lost_frames import Met
from decomotion.source_file import SourceFile

if TYPE_CHECKING:
    from av import VideoFrame

FOLDER = "videos"
"""In the cache."""
VERSION = 2
"""Raised whenever the same file would give other frames or marks."""


@dataclass
class Survey:
    """Of the first frames of a stream, or of all."""

    met: Met = field(default_factory=Met)
    display: Display = field(default_factory=Display)
    """By the first frame."""
    sizes: list[tuple[int, int]] = field(default_factory=list)
    """(height, width) of each frame as it is stored; of a survey that was kept, one for all."""
    marks: list[int] = field(default_factory=list)
    pts: list[int | None] = field(default_factory=list)

    def add(self, frame: VideoFrame) -> None:
        """Notes the next frame; `met` knows of it already."""
        if not self.marks:
            self.display = Display.of(frame)
        self.marks.append(mark(frame))
        self.pts.append(frame.pts)
        self.sizes.append((frame.height, frame.width))

    def keep(self, file: SourceFile, stream: int) -> None:
        """Writes it into the cache, unless that has one of as many frames, or no room."""
        if self.met.losses or len(set(self.sizes)) != 1 or _read(file, stream, len(self.marks)) is not None:
            return
        arrays = {
            "marks": np.array(self.marks, np.uint32),
            "pts": np.array(self.pts, np.int64),
            "times": np.array(self.met.times, np.float64),
            "keys": np.array(self.met.keys, bool),
            "size": np.array(self.sizes[0], np.int64),
            "display": np.array([self.display.x, self.display.y], np.int64),
        }
        with suppress(OSError), replacing(_path(file, stream)) as temporary:
            np.savez_compressed(temporary, allow_pickle=False, **arrays)

    @staticmethod
    def kept(file: SourceFile, stream: int, count: int) -> Survey | None:
        """Of the first `count` frames, as `keep` wrote it; None where there is none of so many."""
        arrays = _read(file, stream, count)
        if arrays is None:
            return None
        height, width = arrays["size"].tolist()
        (x_of_x, y_of_x), (x_of_y, y_of_y) = arrays["display"].tolist()
        return Survey(
            Met(arrays["times"][:count].tolist(), arrays["keys"][:count].tolist()),
            Display((x_of_x, y_of_x), (x_of_y, y_of_y)),
            [(height, width)],
            arrays["marks"][:count].tolist(),
            arrays["pts"][:count].tolist(),
        )


def _read(file: SourceFile, stream: int, count: int) -> dict[str, np.ndarray] | None:
    """What the cache has of the file, if it is of `count` frames or more."""
    path = _path(file, stream)
    if not path.is_file():
        return None
    with suppress(ClipError, KeyError):
        arrays = read_npz(path, ClipError)
        lengths = {len(arrays[name]) for name in ("marks", "pts", "times", "keys")}
        shapes = arrays["size"].shape, arrays["display"].shape
        if len(lengths) == 1 and lengths.pop() >= count and shapes == ((2,), (2, 2)):
            return arrays
    return None


def _path(file: SourceFile, stream: int) -> Path:
    """By what the file is, without reading it, and by what decodes it."""
    import av

    what = repr((VERSION, file.identity, stream, av.__version__, sorted(av.library_versions.items())))
    return cache_root() / FOLDER / f"{hashlib.sha256(what.encode()).hexdigest()[:16]}.npz"

"""Frames in order, read when they are asked for: never all in memory.

A clip's frames come from files (`frame_files.py`, `video_frames.py`) or are an array; whoever takes `AnyFrames` asks
for `len`, `shape`, single frames, parts, or all in order, and gets the same from both.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from copy import copy
from functools import lru_cache
from typing import Any, SupportsIndex, overload

import numpy as np
import numpy.typing as npt

from decomotion.greys import Grey, small_grey

Image = npt.NDArray[np.uint8]
"""RGB [H, W, 3]."""
Shape = tuple[int, int, int, int]

KEPT, KEPT_BYTES = 8, 64 << 20
"""The frames read last are kept: at most so many, and as many as fit into so many bytes, but for two."""


READING = 1
"""Raised whenever the same files would give other frames: it is part of their digest."""


class Source(ABC):
    """What frames are read from. Several threads may ask it at once."""

    shape: Shape
    """(T, H, W, 3)."""

    @abstractmethod
    def read(self, number: int) -> Image:
        """The frame of that number, from 0. Raises `ClipError` where it cannot be read any more."""

    @abstractmethod
    def digest(self, numbers: range) -> str:
        """Of the content of those frames: 16 hexadecimal digits."""

    def again(self) -> Source:
        """The same, with a place of its own in the file: where one reads in order, the other does not lead away."""
        return self

    def grey(self, number: int) -> Grey:
        """A frame as `small_grey` makes it, or nearly so where that is faster."""
        return small_grey(self.read(number))


class Frames:
    """Frames RGB uint8 [T, H, W, 3]. `frames[number]` is one, read-only; `frames[begin:end]` are some, none read yet.

    Args:
        source: what they are read from.

    Reading raises `ClipError` where files have changed since they were opened, or do not decode.
    """

    dtype, ndim = np.dtype(np.uint8), 4

    def __init__(self, source: Source) -> None:
        self._source, self._numbers = source, range(source.shape[0])
        frame_bytes = max(1, int(np.prod(source.shape[1:])))
        self._read = lru_cache(max(2, min(KEPT, KEPT_BYTES // frame_bytes)))(source.read)

    def __len__(self) -> int:
        return len(self._numbers)

    @property
    def shape(self) -> Shape:
        """(T, H, W, 3)."""
        return (len(self), *self._source.shape[1:])

    @overload
    def __getitem__(self, key: slice) -> Frames: ...
    @overload
    def __getitem__(self, key: SupportsIndex) -> Image: ...
    def __getitem__(self, key: SupportsIndex | slice) -> Image | Frames:
        if isinstance(key, slice):
            part = copy(self)  # which keeps frames together with it
            part._numbers = self._numbers[key]
            return part
        frame = self._read(self._numbers[key])
        frame.flags.writeable = False
        return frame

    def __iter__(self) -> Iterator[Image]:
        return (self[number] for number in range(len(self)))

    def again(self) -> Frames:
        """The same frames for another reader, at a place of its own. None is kept: it keeps those that it needs."""
        part = copy(self)
        part._source = self._source.again()
        part._read = part._source.read
        return part

    def __array__(self, dtype: npt.DTypeLike | None = None, copy: bool | None = None) -> npt.NDArray[Any]:
        """All of them in memory, for clips that are known to be short."""
        if copy is False:
            raise ValueError("frames that are read when asked for are no array; leave out copy=False")
        frames = np.empty(self.shape, np.uint8)
        for number, frame in enumerate(self):
            frames[number] = frame
        return frames.astype(dtype or np.uint8, copy=False)

    def grey(self, number: int) -> Grey:
        """A frame as `small_grey` makes it, or nearly so where that is faster."""
        return self._source.grey(self._numbers[number])

    def digest(self) -> str:
        """Of their content as the source has it: 16 hexadecimal digits."""
        return self._source.digest(self._numbers)


AnyFrames = Frames | npt.NDArray[np.uint8]
"""Frames from files, or an array uint8 [T, H, W, 3], which may be mapped from a file."""

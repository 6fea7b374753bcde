"""Frames of a video file, decoded when asked for, in any order.

The next frames are decoded on. For others the file is entered at the key frame before; a checksum of each frame says
whether decoding from there gives what decoding from the beginning gave. Where it does not, as where frames build on
some before the key frame, or where the container does not lead there, the file is decoded from its beginning.
"""

from __future__ import annotations

import hashlib
from bisect import bisect_right
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from threading import Lock
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np
import numpy.typing as npt

from decomotion.decoding import Display, decoded, mark, stream_at
from decomotion.frames import READING, Image, Shape, Source
from decomotion.greys import SIDE, Grey, GreyFile, small_grey, stored
from decomotion.lost_frames import Met
from decomotion.source_file import SourceFile

if TYPE_CHECKING:
    from av import VideoFrame
    from av.container import InputContainer
    from av.video.reformatter import VideoReformatter

Picture = TypeVar("Picture", bound=npt.NDArray[Any])

PASSED, PASSED_BYTES = 16, 64 << 20
"""Frames that were decoded on the way to others are kept: at most so many, and as many as fit into so many bytes."""
TRIES = 3
"""Key frames at which the file is entered for a frame, before it is decoded from its beginning."""
NEAR = 16
"""Frames up to so far ahead are reached by decoding on, whatever key frames lie between."""
_REDUCED = 4
"""Times `SIDE`, to which frames are brought before their pixels are averaged without rounding."""


@dataclass(frozen=True)
class FrameIndex:
    """What the opening of a video file has met, by which its frames are found again. Numbers count in the file."""

    shape: Shape
    """(T, H, W, 3) of the frames that are wanted."""
    begin: int
    """Number of the first of them."""
    display: Display
    """How the stored pictures are to be shown."""
    marks: list[int]
    """Checksum of each frame of the file, as far as it was read."""
    pts: list[int] | None
    """When each is shown, strictly increasing, in the stream's unit; None where that does not tell them apart."""
    entries: list[int]
    """The key frames at which the file can be entered, ascending; none where `pts` is None."""
    greys: GreyFile | None
    """A small picture of each wanted frame; None: they are made when asked for."""


class VideoFrames(Source):
    """Reads the frames of one stream of a file."""

    def __init__(self, file: SourceFile, stream: int, index: FrameIndex) -> None:
        self.shape = index.shape
        self._file, self._stream, self._index = file, stream, index
        self._colours = _Reader(file, stream, index, in_colour)
        self._greys = _Reader(file, stream, index, in_grey)

    def read(self, number: int) -> Image:
        """The frame of that number, from 0 at `index.begin`. Raises `ClipError` where the file has changed."""
        return self._colours.read(number)

    def again(self) -> VideoFrames:
        """The same, opened once more when it is first asked."""
        return VideoFrames(self._file, self._stream, self._index)

    def grey(self, number: int) -> Grey:
        """The same in grey and small: as noted at the opening, or as it would have been."""
        greys = self._index.greys
        return stored(self._greys.read(number)) if greys is None else greys[number]

    def digest(self, numbers: range) -> str:
        """Of the file's bytes and of which frames of it these are."""
        begin, end = (self._index.begin + bound for bound in (numbers.start, numbers.stop))
        what = f"frames of a video {READING} {begin}:{end}:{numbers.step} {self._file.digest}"
        return hashlib.sha256(what.encode()).hexdigest()[:16]


def in_colour(frame: VideoFrame, converter: VideoReformatter, display: Display) -> Image:
    """A frame as it is shown."""
    image = np.asarray(converter.reformat(frame, format="rgb24").to_ndarray(), np.uint8)
    return np.ascontiguousarray(display.upright(image))


def in_grey(frame: VideoFrame, converter: VideoReformatter, display: Display) -> Grey:
    """As `small_grey`, without a picture of full size in between."""
    scale = min(1.0, _REDUCED * SIDE / max(frame.height, frame.width))
    size = {"width": max(1, round(frame.width * scale)), "height": max(1, round(frame.height * scale))}
    grey = converter.reformat(frame, **size, format="gray", interpolation="AREA").to_ndarray()
    return small_grey(display.upright(np.asarray(grey, np.uint8)))


class _Reader(Generic[Picture]):
    """Pictures of the frames of one stream of a file, which is open while they are read in order."""

    def __init__(
        self,
        file: SourceFile,
        stream: int,
        index: FrameIndex,
        picture: Callable[[VideoFrame, VideoReformatter, Display], Picture],
    ) -> None:
        from av.video.reformatter import VideoReformatter

        self._container: InputContainer | None = None
        self._file, self._stream, self._index, self._picture = file, stream, index, picture
        self._number_of = {pts: number for number, pts in enumerate(index.pts or ())}
        self._entries = [entry for entry in index.entries if entry > 0]
        self._back = 0  # key frames by which to enter earlier than at the nearest: transport streams lead too far
        self._decoding: Iterator[VideoFrame] = iter(())
        self._next = 0
        self._entered = False  # whether it is not decoded from its beginning
        self._passed: dict[int, Picture] = {}
        self._lock, self._converter = Lock(), VideoReformatter()

    def __del__(self) -> None:  # PyAV's containers and streams hold each other
        self._close()

    def read(self, number: int) -> Picture:
        """Of the frame of that number, from 0 at `index.begin`. Raises `ClipError` where the file has changed."""
        with self._lock:
            self._file.check()
            return self._found(self._index.begin + number)

    def _found(self, number: int) -> Picture:
        """Raises `ClipError` where it is not in the file any more."""
        if number in self._passed:
            return self._passed[number]
        for _ in self._ways_to(number):
            if self._decodes_to(number):
                return self._passed[number]
        self._close()
        raise self._file.changed()

    def _ways_to(self, number: int) -> Iterator[None]:
        """Goes to where decoding may lead to a frame, from the nearest place on; to the next where it did not."""
        place, known = bisect_right(self._entries, number) - 1, self._back
        far = place >= 0 and self._entries[place] > self._next + NEAR
        if self._container is not None and self._next <= number and not far:
            yield
        for self._back in range(known, min(TRIES, place + 1)):  # where it leads there, that is how far back to go
            self._enter(self._entries[place - self._back])
            yield
        self._back = known
        self._open()
        yield

    def _decodes_to(self, number: int) -> bool:
        """Decodes on to a frame; whether it is there and, as far as that is told, as it was at the opening."""
        from av.error import FFmpegError

        try:
            for frame in self._decoding:
                found = self._number(frame)
                if found is None:
                    continue
                if found > number:
                    return False
                self._next = found + 1
                if self._is_as_before(found, frame):
                    if found > number - PASSED:
                        self._pass(found, frame)
                elif found == number or not self._entered:
                    return False
                if found == number:
                    return True
        except FFmpegError:  # nothing decodes from here
            pass
        return False

    def _number(self, frame: VideoFrame) -> int | None:
        """Of a frame that was decoded; None of one that was not there at the opening."""
        if not self._entered:
            return self._next
        return None if frame.pts is None else self._number_of.get(frame.pts)

    def _is_as_before(self, number: int, frame: VideoFrame) -> bool:
        """From the file's beginning, coders decode the same; frames are missing where their times are others."""
        index = self._index
        if self._entered:
            return index.marks[number] == mark(frame)
        return index.pts is None or index.pts[number] == frame.pts

    def _pass(self, number: int, frame: VideoFrame) -> None:
        """Keeps a picture of it; frames themselves, kept, would change what decoders make of those with losses."""
        picture = self._picture(frame, self._converter, self._index.display)
        while self._passed and len(self._passed) >= min(PASSED, PASSED_BYTES // picture.nbytes):
            del self._passed[next(iter(self._passed))]
        self._passed[number] = picture
        if self._next == len(self._index.marks):  # the last that is wanted
            self._close()

    def _enter(self, number: int) -> None:
        from av.error import FFmpegError

        assert self._index.pts is not None, "where times tell nothing there are no entries"
        container = self._container or self._open()
        stream = stream_at(container, self._stream)
        with suppress(FFmpegError):  # what is decoded then tells that it is elsewhere
            container.seek(self._index.pts[number], stream=stream)
        self._decoding, self._next, self._entered = decoded(container, stream, Met()), number, True

    def _open(self) -> InputContainer:
        import av
        from av.error import FFmpegError

        self._close()
        try:
            self._container = av.open(self._file.url)
        except FFmpegError as error:
            raise self._file.changed() from error
        stream = stream_at(self._container, self._stream)
        self._decoding, self._next, self._entered = decoded(self._container, stream, Met()), 0, False
        return self._container

    def _close(self) -> None:
        self._decoding = iter(())
        if self._container is not None:
            self._container.close()
            self._container = None

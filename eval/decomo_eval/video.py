"""One video of a dataset: its frames, wherever they are stored, and its true tracks."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from decomo_eval.errors import DatasetError
from decomotion.errors import ClipError
from decomotion.frame_files import decode_frame, in_8_bits, open_frames
from decomotion.frames import AnyFrames, Frames, Image, Source
from decomotion.images import png


@dataclass(frozen=True)
class EncodedFrames:
    """JPEG or PNG files in a pickle. An orientation in them is not applied: the official reader does not either."""

    name: str
    """Of the video."""
    files: Sequence[bytes]

    def __len__(self) -> int:
        return len(self.files)

    def __getitem__(self, index: int) -> bytes:
        return self.files[index]

    @cached_property
    def size(self) -> tuple[int, int]:
        """(width, height)."""
        height, width = self._decoded(0).shape[:2]
        return width, height

    def frame(self, index: int) -> Image:
        """RGB [H, W, 3]."""
        frame = self._decoded(index)
        if frame.shape[1::-1] != self.size:
            raise DatasetError(f"frame {index} of video {self.name} differs in size from frame 0")
        return frame

    def _decoded(self, index: int) -> Image:
        frame = decode_frame(self.files[index], upright=False)
        if frame is None:
            raise DatasetError(f"frame {index} of video {self.name} does not decode as JPEG or PNG")
        return in_8_bits(frame)


@dataclass(frozen=True)
class FrameFolder:
    """A folder of frames, read as `decomo-train` reads it: upright, and of 8 bits by one scale."""

    files: Sequence[Path]

    def __len__(self) -> int:
        return len(self.files)

    def __getitem__(self, index: int) -> bytes:
        return self.files[index].read_bytes()

    @property
    def size(self) -> tuple[int, int]:
        """(width, height)."""
        with of_dataset():
            _, height, width, _ = open_frames(self.files[:1]).shape
        return width, height

    def frame(self, index: int) -> Image:
        """RGB [H, W, 3]."""
        with of_dataset():
            return self._frames[index]

    @cached_property
    def _frames(self) -> Frames:
        return open_frames(self.files)


@contextmanager
def of_dataset() -> Iterator[None]:
    """What is wrong with a folder of frames is wrong with the dataset."""
    try:
        yield
    except ClipError as error:
        raise DatasetError(str(error)) from error


Stored = npt.NDArray[np.uint8] | EncodedFrames | FrameFolder
"""Frames uint8 [T, H, W, 3], or T image files."""
Figures = Callable[[npt.NDArray[np.float64], npt.NDArray[np.bool_]], dict[str, float]]
"""From answers, tracks [N, T, 2] in pixels of TAP-Vid's 256x256 raster and occluded [N, T], to figures by name."""


@dataclass(frozen=True, eq=False)
class Video:
    """One video of a dataset with its true tracks, as the file has them."""

    name: str
    """Its key in the dataset; in a dataset that is a list, its position: "0", "1", ...; in a shard that is a list,
    shard and position: "0000_of_0010-0", ..."""
    stored: Stored
    """What `frames` are made from."""
    height: int
    """Of `frames`, as is `width`: the stored frames' own, unless `resized`."""
    width: int
    points: npt.NDArray[np.float64]
    """[N, T, 2], (x, y) as fractions of width and height, 0..1 from edge to edge of the image."""
    occluded: npt.NDArray[np.bool_]
    """[N, T]; where True, the point's position means nothing."""
    resized: bool = False
    """Whether `frames` are the stored ones brought to another size."""
    judged: npt.NDArray[np.bool_] | None = None
    """[N, T]: where annotators said whether the point is seen; elsewhere `occluded` is True and nothing counts.
    None: everywhere."""
    figures: Figures | None = None
    """A benchmark's own figures (`readers/`), as its own code counts, of answers to the queries of the mode `first`."""

    @property
    def num_frames(self) -> int:
        """T."""
        return self.occluded.shape[1]

    def frames(self) -> AnyFrames:
        """The frames, RGB uint8 [T, H, W, 3]; those of files, and resized ones, are made when they are asked for.

        Then `DatasetError` is raised where one does not decode.
        """
        return Frames(_MadeFrames(self)) if self.resized or not isinstance(self.stored, np.ndarray) else self.stored

    def at(self, height: int, width: int) -> Video:
        """The same video with frames of that size; where they shrink, pixels are averages."""
        if (height, width) == (self.height, self.width):
            return self
        return replace(self, height=height, width=width, resized=True)

    def digest(self) -> str:
        """Of the stored frames and the size that they are brought to: 16 hexadecimal digits."""
        return _digest(self, range(self.num_frames))


class _MadeFrames(Source):
    """Those of a video, from what is stored."""

    def __init__(self, video: Video) -> None:
        self.shape = (video.num_frames, video.height, video.width, 3)
        self._video = video

    def read(self, number: int) -> Image:
        stored, (_, height, width, _) = self._video.stored, self.shape
        frame = stored[number] if isinstance(stored, np.ndarray) else stored.frame(number)
        if not self._video.resized:
            return frame
        return np.asarray(cv2.resize(frame, (width, height), interpolation=cv2.INTER_AREA), np.uint8)

    def digest(self, numbers: range) -> str:
        return _digest(self._video, numbers)


def _digest(video: Video, numbers: range) -> str:
    content = hashlib.sha256(f"{len(numbers)} {video.height} {video.width}".encode())
    for number in numbers:
        frame = video.stored[number]
        content.update(frame.tobytes() if isinstance(frame, np.ndarray) else frame)
    return content.hexdigest()[:16]


def write_frames(video: Video, folder: Path) -> Path:
    """Writes the video as a folder of PNGs, which `decomo-train` takes, and returns the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for index, frame in enumerate(video.frames()):
        (folder / f"{index:05d}.png").write_bytes(png(frame))
    return folder


def made_video(
    where: str,
    name: str,
    stored: Any,
    points: Any,
    occluded: Any,
    *,
    judged: npt.NDArray[np.bool_] | None = None,
    figures: Figures | None = None,
) -> Video:
    """A checked video. `where` begins the messages of the `DatasetError` that is raised where something is amiss.

    Args:
        where: what is read.
        name: of the video.
        stored: uint8 [T, H, W, 3], JPEG or PNG files as bytes, or a `FrameFolder`.
        points: numbers [N, T, 2], (x, y) as fractions of width and height.
        occluded: [N, T] of true and false.
        judged: as of `Video`.
        figures: as of `Video`.
    """
    points, occluded = numbers(where, "points", points), numbers(where, "occluded", occluded)
    if points.ndim != 3 or points.shape[2] != 2 or occluded.shape != points.shape[:2]:
        raise DatasetError(
            f"{where} must have points [N, T, 2] and occluded [N, T], but they are {list(points.shape)} "
            f"and {list(occluded.shape)}"
        )
    occluded = flags(where, "occluded", occluded)
    _check_visible(where, points[~occluded])
    frames = _check_stored(where, name, stored, num_frames=occluded.shape[1])
    width, height = frames.shape[2:0:-1] if isinstance(frames, np.ndarray) else frames.size
    return Video(name, frames, height, width, points, occluded, judged=judged, figures=figures)


def numbers(where: str, key: str, value: Any) -> npt.NDArray[np.float64]:
    """An array of numbers, else `DatasetError`."""
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "biuf":
        raise DatasetError(f"{where} must have an array of numbers as {key}")
    return np.asarray(value, dtype=np.float64)


def flags(where: str, key: str, value: Any) -> npt.NDArray[np.bool_]:
    """An array of true and false, else `DatasetError`."""
    value = numbers(where, key, value)
    if not np.isin(value, (0, 1)).all():
        raise DatasetError(f"{where} must have only true and false in {key}")
    return value.astype(bool)


def _check_visible(where: str, points: npt.NDArray[np.float64]) -> None:
    """Visible points may stand a little outside the image, but a point at 3 shows a file in pixels."""
    if not np.isfinite(points).all():
        raise DatasetError(f"{where} has visible points that are not finite")
    if points.size and (points.min() < -1 or points.max() > 2):
        raise DatasetError(
            f"{where} must have points as fractions of width and height in 0..1, but they run from "
            f"{points.min():g} to {points.max():g}; divide x by the width and y by the height"
        )


def _check_stored(where: str, name: str, stored: Any, num_frames: int) -> Stored:
    frames: Stored
    if isinstance(stored, FrameFolder):
        frames = stored
    elif isinstance(stored, np.ndarray) and stored.dtype.kind == "S" and stored.ndim == 1:
        frames = EncodedFrames(name, stored.tolist())
    elif isinstance(stored, np.ndarray) and stored.dtype == np.uint8 and stored.ndim == 4 and stored.shape[3] == 3:
        frames = np.asarray(stored)
    elif isinstance(stored, list | tuple) and all(isinstance(frame, bytes) for frame in stored):
        frames = EncodedFrames(name, stored)
    else:
        raise DatasetError(f"{where} must have as video a uint8 array [T, H, W, 3] or JPEG or PNG files as bytes")
    if not len(frames) == num_frames > 0:
        raise DatasetError(f"{where} must have as many frames as points and occluded, {num_frames}, not {len(frames)}")
    return frames

"""Videos with true tracks: TAP-Vid's pickles, folders of their shards, and folders of frames with `.npz` of tracks.

DAVIS and RGB-Stacking are one pickle each, a dict and a list of videos; Kinetics and RoboTAP are folders of several,
the former with JPEG files as frames. What lies in a folder is read when a video is asked for, and forgotten at the
next: one shard is in memory at a time, and of frames in files those that were asked for last.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from decomo_eval import safe_pickle
from decomo_eval.errors import DatasetError
from decomo_eval.names import ORIGINAL, RESOLUTIONS
from decomo_runtime.layouts import RASTER_SIZE
from decomotion.arrays import read_npz
from decomotion.errors import ClipError
from decomotion.frame_files import decode_frame, frame_files, in_8_bits, open_frames
from decomotion.frames import AnyFrames, Frames, Image, Source
from decomotion.images import png

_KEYS = ("video", "points", "occluded")


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
        with _of_dataset():
            _, height, width, _ = open_frames(self.files[:1]).shape
        return width, height

    def frame(self, index: int) -> Image:
        """RGB [H, W, 3]."""
        with _of_dataset():
            return self._frames[index]

    @cached_property
    def _frames(self) -> Frames:
        return open_frames(self.files)


@contextmanager
def _of_dataset() -> Iterator[None]:
    """What is wrong with a folder of frames is wrong with the dataset."""
    try:
        yield
    except ClipError as error:
        raise DatasetError(str(error)) from error


Stored = npt.NDArray[np.uint8] | EncodedFrames | FrameFolder
"""Frames uint8 [T, H, W, 3], or T image files."""


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


def read_dataset(path: str | Path, resolution: str = ORIGINAL) -> Mapping[str, Video]:
    """Opens a dataset; videos by name, in the file's order, shards and files in alphabetic order.

    Args:
        path: a TAP-Vid pickle (numpy 1 or 2), a folder of such (`*.pkl`: the shards of TAP-Vid-Kinetics, the splits
            of RoboTAP), or a folder of `<video>.npz` with `tracks` and `occluded` beside `<video>/` with its frames.
        resolution: `original`, frames as they are stored, or `256x256`, brought to that size: TAP-Vid's categories.

    Nothing in a file is executed. No video is looked at before it is asked for. Raises
    `DatasetError`; of a video when it is asked for.
    """
    if resolution not in RESOLUTIONS:
        raise DatasetError(f"there is no resolution {resolution}; choose of {', '.join(RESOLUTIONS)}")
    stored = _read_stored(Path(path))
    return stored if resolution == ORIGINAL else ResizedDataset(stored, RASTER_SIZE, RASTER_SIZE)


def _read_stored(path: Path) -> Mapping[str, Video]:
    if not path.is_dir():
        return PickleDataset(path)
    if shards := _files(path, ".pkl"):
        return ShardedDataset(shards)
    if files := _files(path, ".npz"):
        return FolderDataset(files)
    raise DatasetError(f"{path} holds neither .pkl, TAP-Vid's files, nor .npz, tracks beside folders of frames")


class PickleDataset(Mapping[str, Video]):
    """Videos of one pickle, which is in memory; what is wrong with one is said when it is asked for."""

    def __init__(self, path: Path) -> None:
        self._path, self._entries = path, _entries(path)

    def __getitem__(self, name: str) -> Video:
        return _read_video(self._path, name, self._entries[name])

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)


class ShardedDataset(Mapping[str, Video]):
    """Videos of several pickles, the last used of which is in memory. Every shard is read once for its names.

    Raises `DatasetError` where two shards have a video of one name.
    """

    def __init__(self, shards: Sequence[Path]) -> None:
        self._shard_of: dict[str, Path] = {}
        self._loaded: tuple[Path, dict[str, Any]] | None = None
        for shard in shards:
            for name in self._entries(shard):
                if name in self._shard_of:
                    raise DatasetError(f"{shard} and {self._shard_of[name]} both have a video {name}")
                self._shard_of[name] = shard

    def __getitem__(self, name: str) -> Video:
        shard = self._shard_of[name]
        return _read_video(shard, name, self._entries(shard)[name])

    def __iter__(self) -> Iterator[str]:
        return iter(self._shard_of)

    def __len__(self) -> int:
        return len(self._shard_of)

    def _entries(self, shard: Path) -> dict[str, Any]:
        if self._loaded is None or self._loaded[0] != shard:
            self._loaded = None  # before the next is read: never two in memory
            self._loaded = shard, _entries(shard, prefix=f"{shard.stem}-")
        return self._loaded[1]


class FolderDataset(Mapping[str, Video]):
    """Videos as folders of frames, each beside a `.npz` of its name.

    `tracks` [N, T, 2] are (x, y) in pixels of the frames, pixel centres at integers, `occluded` is [N, T]; other keys
    are not read.
    """

    def __init__(self, files: Sequence[Path]) -> None:
        self._files = {file.stem: file for file in files}

    def __getitem__(self, name: str) -> Video:
        file, folder = self._files[name], self._files[name].with_suffix("")
        truth = read_npz(file, DatasetError, ("tracks", "occluded"))
        if not folder.is_dir() or "tracks" not in truth or "occluded" not in truth:
            raise DatasetError(f"{file} must hold tracks and occluded, and {folder} the video's frames")
        with _of_dataset():
            frames = FrameFolder(frame_files(folder))
        tracks = _numbers(f"video {name} of {file}", "tracks", truth["tracks"])
        if tracks.ndim != 3 or tracks.shape[2] != 2:
            raise DatasetError(f"{file} must have tracks [N, T, 2], but they are {list(tracks.shape)}")
        entry = {"video": frames, "points": (tracks + 0.5) / frames.size, "occluded": truth["occluded"]}
        return _read_video(file, name, entry)

    def __iter__(self) -> Iterator[str]:
        return iter(self._files)

    def __len__(self) -> int:
        return len(self._files)


class ResizedDataset(Mapping[str, Video]):
    """A dataset's videos with frames of another size."""

    def __init__(self, stored: Mapping[str, Video], height: int, width: int) -> None:
        self._stored, self._size = stored, (height, width)

    def __getitem__(self, name: str) -> Video:
        return self._stored[name].at(*self._size)

    def __iter__(self) -> Iterator[str]:
        return iter(self._stored)

    def __len__(self) -> int:
        return len(self._stored)


def _files(folder: Path, suffix: str) -> list[Path]:
    """In alphabetic order, without hidden ones: a file that is still being written is one."""
    return sorted(file for file in folder.glob(f"*{suffix}") if not file.name.startswith("."))


def _entries(path: Path, prefix: str = "") -> dict[str, Any]:
    """The videos of one pickle by name; those of a list are named by `prefix` and their position."""
    content = safe_pickle.load(path)
    if isinstance(content, Mapping):
        if not all(isinstance(name, str | int) for name in content):
            raise DatasetError(f"{path} must name its videos by text")
        entries = {str(name): entry for name, entry in content.items()}
    elif isinstance(content, list | tuple):
        entries = {f"{prefix}{index}": entry for index, entry in enumerate(content)}
    else:
        raise DatasetError(f"{path} holds a {type(content).__name__}; TAP-Vid's form is a dict or list of videos")
    if not entries:
        raise DatasetError(f"{path} holds no videos")
    return entries


def write_frames(video: Video, folder: Path) -> Path:
    """Writes the video as a folder of PNGs, which `decomo-train` takes, and returns the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for index, frame in enumerate(video.frames()):
        (folder / f"{index:05d}.png").write_bytes(png(frame))
    return folder


def _read_video(path: str | Path, name: str, entry: Any) -> Video:
    where = f"video {name} of {path}"
    if not isinstance(entry, Mapping) or any(key not in entry for key in _KEYS):
        raise DatasetError(f"{where} lacks one of the keys {', '.join(_KEYS)} of TAP-Vid's form")
    points = _numbers(where, "points", entry["points"])
    occluded = _numbers(where, "occluded", entry["occluded"])
    if points.ndim != 3 or points.shape[2] != 2 or occluded.shape != points.shape[:2]:
        raise DatasetError(
            f"{where} must have points [N, T, 2] and occluded [N, T], but they are {list(points.shape)} "
            f"and {list(occluded.shape)}"
        )
    if not np.isin(occluded, (0, 1)).all():
        raise DatasetError(f"{where} must have only true and false in occluded")
    occluded = occluded.astype(bool)
    _check_visible(where, points[~occluded])
    stored = _check_stored(where, name, entry["video"], num_frames=occluded.shape[1])
    width, height = stored.shape[2:0:-1] if isinstance(stored, np.ndarray) else stored.size
    return Video(name, stored, height, width, points, occluded)


def _numbers(where: str, key: str, value: Any) -> npt.NDArray[np.float64]:
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "biuf":
        raise DatasetError(f"{where} must have an array of numbers as {key}")
    return np.asarray(value, dtype=np.float64)


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

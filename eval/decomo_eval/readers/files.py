"""Files of a dataset: which there are, in alphabetic order without hidden ones, and arrays of numbers in them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
import numpy.typing as npt

from decomo_eval.errors import DatasetError
from decomo_eval.video import FrameFolder, Video, of_dataset
from decomotion.arrays import read_npz
from decomotion.frame_files import frame_files

Source = TypeVar("Source")
Refused = Callable[[Path, DatasetError], object]
"""Told of a file of several videos that cannot be read, and why: these are left out."""
Array = npt.NDArray[Any]


class Videos(Mapping[str, Video], Generic[Source]):
    """Videos that are read each time that they are asked for, from what is known of them by name."""

    def __init__(self, sources: Mapping[str, Source], read: Callable[[str, Source], Video]) -> None:
        self._sources, self._read = sources, read

    def __getitem__(self, name: str) -> Video:
        return self._read(name, self._sources[name])

    def __iter__(self) -> Iterator[str]:
        return iter(self._sources)

    def __len__(self) -> int:
        return len(self._sources)


def by_suffix(folder: Path, suffix: str) -> list[Path]:
    """The files of a folder whose names end so; a file that is still being written is hidden."""
    return sorted(file for file in folder.glob(f"*{suffix}") if not file.name.startswith("."))


def by_scene(folder: Path, *names: str) -> dict[str, Path]:
    """The file of one of these names in each folder within, by that folder's name; folders without one are left out.

    Of several, it is the one named first.
    """
    found = {}
    for scene in sorted(folder.iterdir()) if folder.is_dir() else ():
        files = [scene / name for name in names if not scene.name.startswith(".") and (scene / name).is_file()]
        if files:
            found[scene.name] = files[0]
    return found


def frame_folder(folder: Path) -> FrameFolder:
    """The frames in a folder; `DatasetError` where there are none, or their order is not clear."""
    if not folder.is_dir():
        raise DatasetError(f"{folder} is missing; it must hold the video's frames")
    with of_dataset():
        return FrameFolder(frame_files(folder))


def arrays(file: Path, **axes: int) -> dict[str, Array]:
    """The arrays of an .npz file by key, each of numbers and of as many axes as said; `DatasetError` otherwise."""
    found = read_npz(file, DatasetError, axes)
    for key, number in axes.items():
        if key not in found:
            raise DatasetError(f"{file} lacks the array {key}")
        checked(str(file), key, found[key], number)
    return found


def checked(where: str, key: str, array: Array, axes: int) -> Array:
    """The array, of numbers and of so many axes; `DatasetError` otherwise."""
    if array.dtype.kind not in "biuf" or array.ndim != axes:
        raise DatasetError(
            f"{where} must have an array of numbers with {axes} axes as {key}, not {list(array.shape)} of {array.dtype}"
        )
    return array


def first_frames(where: str, found: Mapping[str, Array], num_frames: int) -> dict[str, Array]:
    """Arrays [T, N, ...] cut to the video's frames, all of one N; `DatasetError` where one is shorter, or differs."""
    points = {array.shape[1] for array in found.values()}
    if len(points) != 1 or min(len(array) for array in found.values()) < num_frames:
        shapes = ", ".join(f"{key} {list(array.shape)}" for key, array in found.items())
        raise DatasetError(
            f"{where} must have as many points in each array, in each of {num_frames} frames, not {shapes}"
        )
    return {key: array[:num_frames] for key, array in found.items()}


def evenly(number: int, wanted: int) -> npt.NDArray[np.int64]:
    """Numbers of so many points, evenly spaced from the first to the last; of all where there are no more."""
    return np.linspace(0, number - 1, min(number, wanted)).astype(np.int64)

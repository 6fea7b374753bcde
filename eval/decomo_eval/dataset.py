"""Datasets of videos with true tracks: which one a path holds, and its videos by name.

What lies in a folder is read when a video is asked for, and forgotten at the next: one file of tracks is in memory at a
time, and of frames in files those that were asked for last.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from decomo_eval.errors import DatasetError
from decomo_eval.names import ORIGINAL, RESOLUTIONS
from decomo_eval.readers import READERS, Reader
from decomo_eval.readers.files import Refused
from decomo_eval.video import Video as Video
from decomo_eval.video import write_frames as write_frames
from decomo_runtime.layouts import RASTER_SIZE


def read_dataset(
    path: str | Path, resolution: str = ORIGINAL, name: str | None = None, refused: Refused | None = None
) -> Mapping[str, Video]:
    """Opens a dataset; videos by name, in the file's order, shards and files in alphabetic order.

    Args:
        path: a TAP-Vid pickle (numpy 1 or 2), or the folder of one of the datasets of `readers.READERS`.
        resolution: `original`, frames as they are stored, or `256x256`, brought to that size: TAP-Vid's categories.
        name: the reader's; by default the one to which the folder's files belong.
        refused: called with each shard that cannot be read, and why: its videos are left out. Without this, or where
            none can be read, the first one ends all.

    Nothing in a file is executed. No video is looked at before it is asked for. Raises `DatasetError`, also where the
    files belong to two readers; of a video when it is asked for.
    """
    if resolution not in RESOLUTIONS:
        raise DatasetError(f"there is no resolution {resolution}; choose of {', '.join(RESOLUTIONS)}")
    path = Path(path)
    stored = chosen_reader(path, name).read(path, refused)
    return stored if resolution == ORIGINAL else ResizedDataset(stored, RASTER_SIZE, RASTER_SIZE)


def chosen_reader(path: str | Path, name: str | None = None) -> Reader:
    """The reader of that name, or the one to which the files at `path` belong; `DatasetError` where that is not one."""
    path = Path(path)
    if name is not None:
        if name not in READERS:
            raise DatasetError(f"there is no dataset {name}; choose of {', '.join(READERS)}")
        if not READERS[name].holds(path):
            raise DatasetError(f"{path} is not of {name}, which is {READERS[name].layout}")
        return READERS[name]
    found = [known for known, reader in READERS.items() if reader.holds(path)]
    if not found:
        layouts = "; ".join(f"{known}: {reader.layout}" for known, reader in READERS.items())
        raise DatasetError(f"{path} holds no dataset that is known ({layouts})")
    if len(found) > 1:
        raise DatasetError(f"{path} holds the files of {' and of '.join(found)}; say which by --dataset")
    return READERS[found[0]]


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

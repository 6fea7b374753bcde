"""TAP-Vid's pickles: DAVIS and RGB-Stacking are one file each, Kinetics and RoboTAP are folders of several.

A file is a dict or a list of videos with `video`, `points` and `occluded`, the points as fractions of width and height
in 0..1 from edge to edge of the image. Of folders, one file is in memory at a time.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from decomo_eval import safe_pickle
from decomo_eval.errors import DatasetError
from decomo_eval.readers.files import Refused, Videos, by_suffix
from decomo_eval.video import Video, made_video

_KEYS = ("video", "points", "occluded")
LAYOUT = "a pickle, or a folder of .pkl"


def holds(path: Path) -> bool:
    """Whether this is a file, or a folder of pickles."""
    return not path.is_dir() or bool(by_suffix(path, ".pkl"))


def read(path: Path, refused: Refused | None = None) -> Mapping[str, Video]:
    """The videos by name; those of a list are named by their position, in a folder behind the file's name.

    A file of a folder that cannot be read ends all, unless somebody is to be told that it is `refused`.
    """
    if not path.is_dir():
        return Videos(_entries(path), partial(_read_video, path))
    return ShardedDataset(by_suffix(path, ".pkl"), refused)


class ShardedDataset(Mapping[str, Video]):
    """Videos of several pickles, the last used of which is in memory. Every shard is read once for its names.

    Raises `DatasetError` where two shards have a video of one name, and where one cannot be read and nobody is to be
    told that it is `refused`, or none can.
    """

    def __init__(self, shards: Sequence[Path], refused: Refused | None = None) -> None:
        self._shard_of: dict[str, Path] = {}
        self._loaded: tuple[Path, dict[str, Any]] | None = None
        damaged: dict[Path, DatasetError] = {}
        for shard in shards:
            try:
                names = list(self._entries(shard))
            except DatasetError as error:
                if refused is None:
                    raise
                damaged[shard] = error
                continue
            for name in names:
                if name in self._shard_of:
                    raise DatasetError(f"{shard} and {self._shard_of[name]} both have a video {name}")
                self._shard_of[name] = shard
        for shard, error in damaged.items():
            if refused is None or not self._shard_of:
                raise error
            refused(shard, error)

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


def _read_video(path: Path, name: str, entry: Any) -> Video:
    where = f"video {name} of {path}"
    if not isinstance(entry, Mapping) or any(key not in entry for key in _KEYS):
        raise DatasetError(f"{where} lacks one of the keys {', '.join(_KEYS)} of TAP-Vid's form")
    return made_video(where, name, *(entry[key] for key in _KEYS))

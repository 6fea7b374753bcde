"""The datasets that are read: one file each, and one line of `READERS`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from decomo_eval.query_mode import FIRST, STRIDED
from decomo_eval.readers import badja, dynamic_replica, egopoints, folder, pointodyssey, tapvid
from decomo_eval.readers.files import Refused
from decomo_eval.video import Video


@dataclass(frozen=True)
class Reader:
    """How to know a dataset and to read it."""

    name: str
    """As `--dataset` takes it."""
    layout: str
    """What it consists of, for messages."""
    holds: Callable[[Path], bool]
    """Whether a path has its files, by their names alone."""
    read: Callable[[Path, Refused | None], Mapping[str, Video]]
    """The videos by name; `DatasetError` where a file is not as it should be, of one video when it is asked for. With
    somebody to tell, a file of several videos that cannot be read costs these alone."""
    query_mode: str
    """In which it is scored by default."""


def _of_one_each(read: Callable[[Path], Mapping[str, Video]]) -> Callable[[Path, Refused | None], Mapping[str, Video]]:
    """Of files of one video each."""
    return lambda path, _: read(path)


_ALL = (
    Reader("tapvid", tapvid.LAYOUT, tapvid.holds, tapvid.read, STRIDED),
    Reader("folder", folder.LAYOUT, folder.holds, _of_one_each(folder.read), STRIDED),
    Reader("pointodyssey", pointodyssey.LAYOUT, pointodyssey.holds, _of_one_each(pointodyssey.read), FIRST),
    Reader("egopoints", egopoints.LAYOUT, egopoints.holds, _of_one_each(egopoints.read), FIRST),
    Reader("dynamic-replica", dynamic_replica.LAYOUT, dynamic_replica.holds, _of_one_each(dynamic_replica.read), FIRST),
    Reader("badja", badja.LAYOUT, badja.holds, _of_one_each(badja.read), FIRST),
)
READERS = {reader.name: reader for reader in _ALL}
"""By name."""

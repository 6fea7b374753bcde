"""The datasets that are read: one file each, and one line of `READERS`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from decomo_eval.query_mode import FIRST, STRIDED
from decomo_eval.readers import badja, dynamic_replica, egopoints, folder, pointodyssey, tapvid
from decomo_eval.video import Video


@dataclass(frozen=True)
class Reader:
    """How to know a dataset and to read it."""

    layout: str
    """What it consists of, for messages."""
    holds: Callable[[Path], bool]
    """Whether a path has its files, by their names alone."""
    read: Callable[[Path], Mapping[str, Video]]
    """The videos by name; `DatasetError` where a file is not as it should be, of one video when it is asked for."""
    query_mode: str
    """In which it is scored by default."""


READERS: dict[str, Reader] = {
    "tapvid": Reader(tapvid.LAYOUT, tapvid.holds, tapvid.read, STRIDED),
    "folder": Reader(folder.LAYOUT, folder.holds, folder.read, STRIDED),
    "pointodyssey": Reader(pointodyssey.LAYOUT, pointodyssey.holds, pointodyssey.read, FIRST),
    "egopoints": Reader(egopoints.LAYOUT, egopoints.holds, egopoints.read, FIRST),
    "dynamic-replica": Reader(dynamic_replica.LAYOUT, dynamic_replica.holds, dynamic_replica.read, FIRST),
    "badja": Reader(badja.LAYOUT, badja.holds, badja.read, FIRST),
}
"""By name, as `--dataset` takes it."""

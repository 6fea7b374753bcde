"""Tracks as csv, a line for each point and frame, written and read a block of lines at a time.

`time`, in seconds, and `error`, in pixels, are the last columns, and each is absent where it is not known.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain, islice
from pathlib import Path
from typing import Any, TextIO

import numpy as np
import numpy.typing as npt

from decomo_runtime.errors import TracksFileError
from decomo_runtime.formats.about import About
from decomo_runtime.tracks import Tracks
from decomotion.tables import Table, opened_table

FORMATS = {
    "point": "%d",
    "frame": "%d",
    "x": "%.4f",
    "y": "%.4f",
    "occlusion": "%.4f",
    "occluded": "%d",
    "query_t": "%d",
    "query_x": "%.4f",
    "query_y": "%.4f",
}
"""What each column is written as."""
TIME, ERROR = "time", "error"
WHERE_KNOWN = {TIME: "%.6f", ERROR: "%.4f"}
"""Likewise, the columns that may be absent."""
LINES = 2**15
"""In memory at once."""
_KEPT = {"point": "i4", "frame": "i4", "x": "f4", "y": "f4", "occlusion": "f4", "occluded": "?"}
_QUERY = ("query_t", "query_x", "query_y")


def write(tracks: Tracks, path: Path, _: About) -> None:
    """A line for each point and frame; nothing of the clip's size."""
    with open(path, "w", encoding="utf-8", newline="") as file:
        _write(file, tracks)


def read(path: Path) -> tuple[Tracks, About]:
    """Raises `TracksFileError` where the file is none that `write` wrote; `tables.py` says in which forms it may be."""
    return Tracks(**_read(path)), About()


def _write(file: TextIO, tracks: Tracks) -> None:
    known = {TIME: tracks.times is not None, ERROR: tracks.error is not None}
    formats = FORMATS | {name: form for name, form in WHERE_KNOWN.items() if known[name]}
    file.write(",".join(formats) + "\n")
    points, length = tracks.occluded.shape
    step = max(1, LINES // max(1, length))
    for begin in range(0, points if length else 0, step):
        rows = slice(begin, begin + step)
        point, column = np.indices(tracks.occluded[rows].shape).reshape(2, -1)
        columns = [
            begin + point,
            tracks.frames[column],
            tracks.xy[rows].reshape(-1, 2),
            tracks.occlusion[rows].ravel(),
            tracks.occluded[rows].ravel(),
            tracks.queries[rows][point],
            *([] if tracks.times is None else [tracks.times[column]]),
            *([] if tracks.error is None else [tracks.error[rows].ravel()]),
        ]
        np.savetxt(file, np.column_stack(columns), fmt=",".join(formats.values()))


def _read(path: Path) -> dict[str, Any]:
    """The fields of `Tracks` by name."""
    try:
        with opened_table(path) as table:
            count = table.columns.count
            if any(count(name) != 1 for name in FORMATS) or any(count(name) > 1 for name in WHERE_KNOWN):
                raise ValueError("another header")
            return _fields(path, table)
    except TracksFileError:
        raise
    except (OSError, ValueError, OverflowError) as error:
        raise TracksFileError(
            f"{path} is not a csv file of tracks, {','.join(FORMATS)}; write one with 'decomo-track'"
        ) from error


def _fields(path: Path, table: Table) -> dict[str, npt.NDArray[Any]]:
    kept_types = _KEPT | ({ERROR: "f4"} if ERROR in table.columns else {})
    kept, queries, times = [np.empty(0, list(kept_types.items()))], [np.empty((0, 3), np.float32)], [np.empty(0)]
    points = 0
    for block in _blocks(table):
        kept.append(block[list(kept_types)].astype(kept[0].dtype))
        first = np.flatnonzero(np.diff(block["point"], prepend=points - 1))  # line of each point that begins here
        queries.append(np.stack([block[name][first] for name in _QUERY], axis=1))
        points += len(first)
        if TIME in table.columns:
            times.append(block[TIME][block["point"] == 0])
    rows = np.concatenate(kept)
    length = len(rows) // points if points else 0
    in_order = len(rows) == points * length and bool((rows["point"] == np.repeat(np.arange(points), length)).all())
    grid = rows.reshape(points, length) if in_order else rows[None]
    if not in_order or (grid["frame"] != grid["frame"][:1]).any():
        raise TracksFileError(f"{path} must have a line for each point and frame, in order; some are missing")
    fields = {
        "xy": np.stack([grid["x"], grid["y"]], axis=-1),
        "occluded": grid["occluded"].copy(),
        "occlusion": grid["occlusion"].copy(),
        "queries": np.concatenate(queries),
        "frames": (grid["frame"][0] if points else np.empty(0)).astype(np.int64),
    }
    fields |= {"times": np.concatenate(times)} if TIME in table.columns else {}
    return fields | ({ERROR: grid[ERROR].copy()} if ERROR in table.columns else {})


def _blocks(table: Table) -> Iterator[npt.NDArray[Any]]:
    """The lines as structured arrays, `LINES` at a time."""
    optional = {name: kind for name, kind in ((TIME, "f8"), (ERROR, "f4")) if name in table.columns}
    columns = _KEPT | dict.fromkeys(_QUERY, "f4") | optional
    lines = (table.number(line) for line in table.lines if not line.isspace())
    for line in lines:
        yield np.loadtxt(
            chain([line], islice(lines, LINES - 1)),
            dtype=list(columns.items()),
            delimiter=table.separator,
            comments=None,
            quotechar='"',
            usecols=[table.columns.index(name) for name in columns],
            ndmin=1,
        )

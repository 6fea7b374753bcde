"""DeepLabCut's tables: predictions, a row for each frame of the video, and labels, a row for each labelled image.

Columns are named by `scorer`, (`individuals`,) `bodyparts` and `coords`: x, y and, of predictions, likelihood. Pixel
centres are at whole numbers, frames count from 0. An image is named by its frame: img0012.png.
"""

from __future__ import annotations

import csv
import io
import pickle
import re
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from decomo_runtime.errors import QueryError, TracksFileError
from decomo_runtime.formats.about import About
from decomo_runtime.formats.frames import in_order, likelihood
from decomo_runtime.formats.keypoints import Keypoints
from decomo_runtime.formats.keys import shown
from decomo_runtime.formats.objects import objects_of
from decomo_runtime.tracks import Tracks
from decomotion.files import check_room
from decomotion.tables import opened_table

LEVELS = ("scorer", "individuals", "bodyparts", "coords")
"""Of the header, from the top; `individuals` is absent where there is one animal."""
_ONE_ANIMAL = (LEVELS[0], *LEVELS[2:])
COORDS = ("x", "y", "likelihood")
SCORER = "decomotion"
KEY = "df_with_missing"
"""Of the table in an h5 file."""
MOST_FRAMES = 10**6
"""That a table has rows for."""
_ROOM = 2**20
"""Bytes of an .h5 beside its rows."""
MOST_BYTES = 2**31
"""That are read of a file."""
_OF_H5 = RuntimeError, pickle.UnpicklingError
"""What h5py and names in its files may end in, beside the errors of a table."""
_LONGEST = 2**16 - 2**10
"""Bytes of all names in an h5 file, less than HDF5's limit of an attribute."""
_Columns = Sequence[tuple[str, ...]]
_GIVE = "give one that DeepLabCut wrote"


def check(_: int, frames: npt.NDArray[np.int64], __: About) -> None:
    """`TracksFileError` where there are more frames than a table has rows for."""
    first, last = (frames.min(), frames.max()) if len(frames) else (0, 0)
    if first < 0 or last >= MOST_FRAMES:
        raise TracksFileError(
            f"DeepLabCut's table has a row for each frame of the video, 0 to {MOST_FRAMES - 1} at most, but there are "
            f"tracks in frames {first} to {last}; mend the tracks"
        )


def write(tracks: Tracks, path: Path, about: About) -> None:
    """Predictions for all frames from the clip's first, with the likelihood of each place (`frames.py`).

    Where a point has no place, and in frames in which none was looked for, cells are empty. Raises `TracksFileError`
    where an .h5 cannot name so many points.
    """
    tracks = in_order(tracks)
    objects = objects_of(about, len(tracks.xy))
    heads = [(name, part) if objects.several else (part,) for name in objects.names for part in objects.parts]
    columns = [(SCORER, *head, coord) for head in heads for coord in COORDS]
    values = np.concatenate([tracks.xy.astype(np.float64), likelihood(tracks, about)[..., None]], axis=-1)
    values[~np.isfinite(values).all(axis=-1)] = np.nan
    values = objects.arranged(values, np.nan).reshape(len(heads), len(tracks.frames), len(COORDS))
    numbers = about.numbers(np.arange(max(about.length or 0, int(tracks.frames[-1]) + 1)), 0)
    rows = np.full((len(numbers), len(columns)), np.nan)
    rows[tracks.frames] = values.transpose(1, 0, 2).reshape(len(tracks.frames), -1)
    (_write_h5 if path.suffix.lower() == ".h5" else _write_csv)(path, columns, numbers, rows)


def _write_csv(path: Path, columns: _Columns, numbers: npt.NDArray[np.int64], rows: npt.NDArray[np.float64]) -> None:
    with open(path, "w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        levels = zip(_levels_of(columns), zip(*columns, strict=True), strict=True)
        table.writerows([level, *names] for level, names in levels)
        for number, row in shown(list(zip(numbers.tolist(), rows, strict=True)), "frames"):
            table.writerow([number, *("" if np.isnan(value) else f"{value:.4f}" for value in row)])


def _write_h5(path: Path, columns: _Columns, numbers: npt.NDArray[np.int64], rows: npt.NDArray[np.float64]) -> None:
    if len(pickle.dumps(columns, protocol=0)) > _LONGEST:
        raise TracksFileError(f"an .h5 of DeepLabCut cannot name {len(columns) // 3} points; write a .csv")
    pandas, _ = import_module("pandas"), import_module("tables")
    check_room(path, _ROOM + 2 * rows.nbytes + 64 * len(rows))
    labels = pandas.MultiIndex.from_tuples(columns, names=_levels_of(columns))
    pandas.DataFrame(rows, index=numbers, columns=labels).to_hdf(path, key=KEY, mode="w", format="table")


def _levels_of(columns: _Columns) -> Sequence[str]:
    return LEVELS if len(columns[0]) == len(LEVELS) else _ONE_ANIMAL


@dataclass(frozen=True)
class _Table:
    levels: Sequence[str]
    columns: _Columns
    index: Sequence[str]
    values: npt.NDArray[np.float64]
    """[row, column]."""


def read_keypoints(path: Path) -> Keypoints:
    """The points of a .csv, or of an .h5 (with the extra `deeplabcut`), labels or predictions.

    A name is that of the body part, behind that of its individual where there are several. `QueryError` where the file
    is none of DeepLabCut's.
    """
    try:
        table = _from_h5(path) if path.suffix.lower() == ".h5" else _from_csv(path)
        return _keypoints(path, table)
    except OSError as error:
        raise QueryError(f"{path} cannot be read ({error.strerror or error}); {_GIVE}") from error
    except QueryError:
        raise
    except (ValueError, LookupError, TypeError, AttributeError, ArithmeticError, EOFError, *_OF_H5) as error:
        raise QueryError(f"{path} is not a table of DeepLabCut ({error}); {_GIVE}") from error


def _from_csv(path: Path) -> _Table:
    with opened_table(path) as opened:
        head, separator = opened.columns, opened.separator
        if not head or head[0] != LEVELS[0]:
            raise ValueError("it does not begin with 'scorer'")
        rows = list(csv.reader(opened.lines, delimiter=separator))
    names = [row[0] if row else "" for row in rows[:3]]
    count = names.index("coords") + 1 if "coords" in names else 0
    levels = ("scorer", *names[:count])
    if levels not in (LEVELS, _ONE_ANIMAL):
        raise ValueError("its header is not scorer, bodyparts, coords")
    head_rows, body = rows[:count], [row for row in rows[count:] if any(row)]
    indexed = next((place for place, name in enumerate(head_rows[-1][1:], 1) if name), len(head_rows[-1]))
    if any(len(row) != len(head) for row in head_rows + body):
        raise ValueError("its lines are not equally long")
    columns = list(zip(*[head[indexed:], *[row[indexed:] for row in head_rows]], strict=True))
    values = [[float(opened.number(cell)) if cell.strip() else np.nan for cell in row[indexed:]] for row in body]
    index = [row[indexed - 1] for row in body]
    return _Table(levels, columns, index, np.array(values, np.float64).reshape(len(body), len(columns)))


def _from_h5(path: Path) -> _Table:
    """pandas itself would run code that such a file may hold; here names are read, and nothing is called."""
    try:
        h5py = import_module("h5py")
    except ModuleNotFoundError as error:
        raise QueryError(
            f"{path} needs h5py, which is not installed; run: pip install 'decomotion[deeplabcut]'"
        ) from error
    with h5py.File(path) as file:
        groups = [group for group in file.values() if "pandas_type" in group.attrs]
        if len(groups) != 1:
            raise ValueError("it does not hold one table of pandas")
        group = groups[0]
        if "table" in group:
            columns = _plain(group.attrs["non_index_axes"])[0][1]
            rows = _content(group["table"])
            if "values_block_1" in (rows.dtype.names or ()):
                raise ValueError("its columns are of several types")
            index, values = [str(number) for number in rows["index"]], rows["values_block_0"]
        else:
            if group.attrs["nblocks"] != 1:
                raise ValueError("its columns are of several types")
            columns, values = list(zip(*_levels(group, "axis0"), strict=True)), _content(group["block0_values"])
            index = _levels(group, "axis1")[-1] if "axis1_level0" in group else [_text(cell) for cell in group["axis1"]]
    return _Table(_levels_of(columns), columns, index, np.asarray(values, np.float64))


def _content(dataset: Any) -> npt.NDArray[Any]:
    """All of it: one that only says to be huge takes no memory."""
    if dataset.size * dataset.dtype.itemsize > MOST_BYTES:
        raise ValueError(f"it has more than {MOST_BYTES >> 30} GiB")
    return dataset[()]


def _levels(group: Any, axis: str) -> list[list[str]]:
    """Of a MultiIndex: its names, level by level."""
    levels = []
    while f"{axis}_level{len(levels)}" in group:
        names = [_text(name) for name in group[f"{axis}_level{len(levels)}"]]
        levels.append([names[number] for number in group[f"{axis}_label{len(levels)}"]])
    return levels


def _text(name: Any) -> str:
    return name.decode() if isinstance(name, bytes) else str(name)


class _Plain(pickle.Unpickler):
    """Lists, tuples, text and numbers: what else a pickle may ask for has to be looked up, which is refused."""

    def find_class(self, module_name: str, global_name: str, /) -> Any:
        raise pickle.UnpicklingError(f"its names are made by {module_name!r}, {global_name!r}, which is not run")


def _plain(pickled: Any) -> Any:
    return _Plain(io.BytesIO(bytes(pickled))).load()


def _keypoints(path: Path, table: _Table) -> Keypoints:
    places: dict[tuple[str, str], dict[str, int]] = {}
    for number, column in enumerate(table.columns):
        named = dict(zip(table.levels, column, strict=True))
        coords = places.setdefault((named.get("individuals", ""), named["bodyparts"]), {})
        if named["coords"] in coords:
            raise ValueError(f"{named['bodyparts']!r} is there twice")
        coords[named["coords"]] = number
    if any(not {"x", "y"} <= coords.keys() <= set(COORDS) for coords in places.values()):
        raise ValueError("its coords are not x, y and likelihood")
    several = len({individual for individual, _ in places}) > 1
    names = [f"{individual}.{part}" if several else part for individual, part in places]
    frames = np.array([_frame(path, cell) for cell in table.index], np.int64)
    order = np.argsort(frames, kind="stable")
    if (np.diff(frames[order]) == 0).any():
        raise ValueError("a frame is there twice")
    values = table.values[order]
    xy = np.array([values[:, [coords["x"], coords["y"]]] for coords in places.values()]).reshape(-1, len(frames), 2)
    there = np.isfinite(xy).all(axis=-1)
    score = [
        values[:, coords["likelihood"]] if "likelihood" in coords else np.ones(len(frames))
        for coords in places.values()
    ]
    return Keypoints(
        tuple(names), frames[order], xy, np.where(there, np.nan_to_num(np.array(score).reshape(there.shape)), 0.0)
    )


def _frame(path: Path, cell: str) -> int:
    """Of a row: its number, or the one in the name of its image."""
    found = re.fullmatch(r"(\d+)", cell.strip()) or re.search(r"(\d+)\.\w+$", cell.strip())
    if found is None:
        raise QueryError(f"{path}: the row {cell!r} does not tell its frame; {_GIVE}, with images as img0012.png")
    return int(found[1])

"""`corrections.csv`: what a user says of tracks, read and checked against the clip (`docs/corrections.md`)."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from decomotion.clip import Clip
from decomotion.corrections.points import CorrectedPoint, Place, points_of
from decomotion.errors import CorrectionError
from decomotion.tables import Table, opened_table

COLUMNS = ("t", "x", "y", "target_t", "target_x", "target_y")
HEADER = ",".join(COLUMNS)


class Correction(NamedTuple):
    """The point at `place` is at `target`, or it is hidden there."""

    place: Place
    target: Place
    """Its x and y are NaN where the point is hidden in the frame."""


def read_corrections(path: str | Path, clip: Clip) -> list[CorrectedPoint]:
    """The points that the file speaks of, at least one, in the order in which it first names them.

    Raises `CorrectionError`, which names the line, where the file is none, a place or frame is not in the clip, or two
    lines contradict each other.
    """
    path = Path(path)
    try:
        read = list(_lines(path))
    except OSError as error:
        raise CorrectionError(f"{path} cannot be read ({error.strerror}); give a csv file: {HEADER}") from error
    except (UnicodeError, csv.Error) as error:
        raise CorrectionError(f"{path} is not a text file; give a csv file in UTF-8: {HEADER}") from error
    if not read:
        raise CorrectionError(f"{path} holds no correction; below its header each line says one")
    for where, correction in read:
        _check(correction, where, clip)
    return points_of(read)


def _lines(path: Path) -> Iterator[tuple[str, Correction]]:
    with opened_table(path) as table:
        missing = [name for name in COLUMNS if table.columns.count(name) != 1]
        if missing:
            raise CorrectionError(f"{path} must begin with the header {HEADER}; it has no column {', '.join(missing)}")
        places = [table.columns.index(name) for name in COLUMNS]
        reader = csv.reader(table.lines, delimiter=table.separator, skipinitialspace=True)
        for row in reader:
            if any(cell.strip() for cell in row):
                where = f"{path}, line {table.header_line + reader.line_num}"
                yield where, _parsed(row, places, where, table)


def _parsed(row: Sequence[str], places: Sequence[int], where: str, table: Table) -> Correction:
    if len(row) != len(table.columns):
        raise CorrectionError(
            f"{where} has {len(row)} values but the header names {len(table.columns)} columns; mend that line"
        )
    cells = [row[place].strip() for place in places]
    if bool(cells[4]) != bool(cells[5]):
        raise CorrectionError(
            f"{where} gives one of target_x and target_y; give both, or neither where the point is hidden"
        )
    try:
        numbers = [float(table.number(cell)) if cell or at < 4 else math.nan for at, cell in enumerate(cells)]
    except ValueError as error:
        raise CorrectionError(
            f"{where} ({table.separator.join(row)}) must give numbers for {HEADER}; the last two may be empty"
        ) from error
    if not all(math.isfinite(number) for number, cell in zip(numbers, cells, strict=True) if cell):
        raise CorrectionError(f"{where} ({table.separator.join(row)}) must give finite numbers; mend that line")
    for name, frame in ((COLUMNS[0], numbers[0]), (COLUMNS[3], numbers[3])):
        if frame != int(frame):
            raise CorrectionError(f"{where}: {name} is {frame:g}; it must be a whole frame number")
    return Correction(Place(int(numbers[0]), *numbers[1:3]), Place(int(numbers[3]), *numbers[4:]))


def _check(correction: Correction, where: str, clip: Clip) -> None:
    for prefix, place in (("", correction.place), ("target_", correction.target)):
        if not 0 <= place.t < len(clip):
            raise CorrectionError(
                f"{where}: {prefix}t is {place.t} but the clip has the frames 0 to {len(clip) - 1}; mend that line"
            )
        for name, value, size in (("x", place.x, clip.width), ("y", place.y, clip.height)):
            if not (math.isnan(value) or -0.5 <= value <= size - 0.5):
                raise CorrectionError(
                    f"{where}: {prefix}{name} is {value:g}, outside of the frame, -0.5 to {size - 0.5}; "
                    f"{'leave it empty where the point is not seen' if prefix else 'mend that line'}"
                )
    if correction.place.t == correction.target.t:
        raise CorrectionError(
            f"{where}: t and target_t are both {correction.place.t}; a correction says where a point is in another "
            "frame than the one that it is named by"
        )

"""Query points and target frames: from command-line text, a csv file or a grid to checked arrays.

A query is (t, x, y): a frame counted from 0 and a place in pixels of the clip, pixel centres at integers, so that the
frame reaches from -0.5 to width - 0.5 and from -0.5 to height - 0.5, borders included.
"""

from __future__ import annotations

import csv
import math
from array import array
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from decomo_runtime.errors import QueryError
from decomo_runtime.model_file import ModelFacts
from decomotion.tables import Table, opened_table

COLUMNS = ("t", "x", "y")


def check_queries(queries: npt.ArrayLike, model: ModelFacts) -> npt.NDArray[np.float32]:
    """`queries` as float32 [N, 3] of (t, x, y); `QueryError` names the first row that is not in the clip."""
    try:
        rows = np.asarray(queries, np.float64)
    except (TypeError, ValueError) as error:
        raise QueryError("queries must be rows of three numbers (t, x, y); got something else") from error
    if rows.shape == (0,):
        rows = rows.reshape(0, 3)
    if rows.ndim != 2 or rows.shape[1] != 3:
        raise QueryError(f"queries must have the shape [N, 3], rows of (t, x, y); got {list(rows.shape)}")
    t, x, y = rows.T
    rules = (
        (~np.isfinite(rows).all(1), "t, x and y must be finite numbers"),
        (t != np.floor(t), "t must be a whole frame number"),
        ((t < 0) | (t > model.num_frames - 1), f"t must be within 0 .. {model.num_frames - 1}, the clip's frames"),
        ((x < -0.5) | (x > model.width - 0.5), f"x must be within -0.5 .. {model.width - 0.5}, inside the frame"),
        ((y < -0.5) | (y > model.height - 0.5), f"y must be within -0.5 .. {model.height - 0.5}, inside the frame"),
    )
    broken = np.stack([bad for bad, _ in rules], axis=1)
    if broken.any():
        row = int(broken.any(1).argmax())
        place = ", ".join(f"{name}={value:g}" for name, value in zip(COLUMNS, rows[row], strict=True))
        raise QueryError(f"query row {row} (counted from 0; {place}): {rules[int(broken[row].argmax())][1]}")
    return rows.astype(np.float32)


def check_frames(frames: npt.ArrayLike | None, num_frames: int) -> npt.NDArray[np.int64]:
    """`frames` as int64 [M], in the order given; None means all `num_frames`."""
    if frames is None:
        return np.arange(num_frames)
    try:
        wanted = np.asarray(frames)
    except ValueError as error:
        raise QueryError("frames must be a list of whole frame numbers; got something else") from error
    if wanted.ndim != 1:
        raise QueryError(f"frames must be a list of whole frame numbers; got the shape {list(wanted.shape)}")
    if len(wanted) == 0:
        return np.empty(0, np.int64)
    if not np.issubdtype(wanted.dtype, np.integer):
        raise QueryError(f"frames must be whole numbers (an integer type); got {wanted.dtype}")
    outside = (wanted < 0) | (wanted >= num_frames)
    if outside.any():
        row = int(outside.argmax())
        raise QueryError(f"frames[{row}] is {wanted[row]}; it must be within 0 .. {num_frames - 1}, the clip's frames")
    return wanted.astype(np.int64)


def parse_points(texts: Sequence[str]) -> npt.NDArray[np.float64]:
    """`["T,X,Y", ...]` as [N, 3] rows of (t, x, y)."""
    points = []
    for text in texts:
        try:
            t, x, y = (float(part) for part in text.split(","))
        except ValueError as error:
            raise QueryError(f"--point {text} is not T,X,Y: a frame and a place, such as 0,120,84.5") from error
        points.append((t, x, y))
    return np.array(points, np.float64).reshape(-1, 3)


def read_queries(path: str | Path) -> npt.NDArray[np.float64]:
    """[N, 3] rows of (t, x, y) from a csv file with a header: t, x and y in any order, other columns are ignored.

    `tables.py` says which forms of csv are read. `QueryError` names the first line that is none.
    """
    path = Path(path)
    values = array("d")
    try:
        with opened_table(path) as table:
            missing = [name for name in COLUMNS if table.columns.count(name) != 1]
            if missing:
                raise QueryError(f"{path} must begin with the header t,x,y; it has no column {', '.join(missing)}")
            places = [table.columns.index(name) for name in COLUMNS]
            reader = csv.reader(table.lines, delimiter=table.separator, skipinitialspace=True)
            for row in reader:
                if row:
                    values.extend(_numbers(row, places, f"{path}, line {table.header_line + reader.line_num}", table))
    except OSError as error:
        raise QueryError(f"{path} cannot be read ({error.strerror}); give a csv file with the header t,x,y") from error
    except (UnicodeError, csv.Error) as error:
        raise QueryError(f"{path} is not a text file; give a csv file in UTF-8 with the header t,x,y") from error
    return np.array(values, np.float64).reshape(-1, 3)


def _numbers(row: Sequence[str], places: Sequence[int], where: str, table: Table) -> list[float]:
    width = len(table.columns)
    if len(row) != width:
        raise QueryError(f"{where} has {len(row)} values but the header names {width} columns; mend that line")
    try:
        return [float(table.number(row[place])) for place in places]
    except ValueError as error:
        raise QueryError(
            f"{where} ({table.separator.join(row)}) must give numbers for t, x and y; mend that line"
        ) from error


def parse_grid(text: str) -> tuple[float, int]:
    """`"STEP@T"` as (step in pixels, frame)."""
    step_text, _, frame_text = text.partition("@")
    try:
        step, frame = float(step_text), int(frame_text)
    except ValueError as error:
        raise QueryError(f"--grid {text} is not STEP@T: a spacing in pixels and a frame, such as 16@0") from error
    if not 1 <= step < math.inf:
        raise QueryError(f"--grid {text}: the spacing must be at least 1 pixel")
    return step, frame


def grid_queries(step: float, frame: int, height: int, width: int) -> npt.NDArray[np.float64]:
    """[N, 3] rows of (t, x, y): points every `step` pixels, row by row, equally far from opposite borders."""
    y, x = np.meshgrid(_centred(height, step), _centred(width, step), indexing="ij")
    return np.stack([np.full(x.size, frame, np.float64), x.ravel(), y.ravel()], axis=1)


def _centred(size: int, step: float) -> npt.NDArray[np.float64]:
    count = int((size - 1) // step) + 1
    return (size - 1 - (count - 1) * step) / 2 + step * np.arange(count, dtype=np.float64)


def parse_frames(text: str, num_frames: int) -> npt.NDArray[np.int64]:
    """`"a:b"` as the frames a, ..., b - 1 (a Python slice without negative numbers; either end may be left out)."""
    first, colon, last = text.partition(":")
    try:
        start, stop = int(first or 0), int(last or num_frames)
    except ValueError:
        colon = ""
        start = stop = 0
    if not colon:
        raise QueryError(f"--frames {text} is not a:b, the frames from a up to but without b, such as 0:10")
    if not 0 <= start < stop <= num_frames:
        raise QueryError(f"--frames {text} must select frames within 0:{num_frames}, the clip's frames")
    return np.arange(start, stop)

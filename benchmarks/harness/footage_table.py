"""Markdown of the records that `footage.py` wrote: one table of all parts, then a table for each part.

Intervals are 95 % of the bootstrap over clips, where a line says so over tracks (`eval/decomo_eval/bootstrap.py`).
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from statistics import fmean, median

from decomo_eval.bootstrap import mean_interval
from decomo_eval.query_mode import FIRST, STRIDED
from harness.full_length import LEGS_NEAR
from harness.markdown import head, line
from harness.plan import FITS
from harness.records import Record, read_records
from harness.summary import AJ, DELTA, POSITION, ClipValues, Column, by_clip

Records = dict[str, Record]
"""By clip."""
NEAR = (4, 16)
"""Pixels within which an end is near its true place."""
MIB = 2**20


def table(folder: Path, chained: Path, reference: Path) -> Iterator[str]:
    """Lines of the tables of the records in `folder`.

    Args:
        folder: of a configuration's records, `<part>/<clip>.json`.
        chained: of the baseline's, likewise.
        reference: of fits of the first 32 frames, one row of `accuracy.py`.
    """
    found = {part: _read(folder / part) for part in ORDER}
    beside = {part: _read(chained / part) for part in ORDER}
    yield from head(["work", "model", "beside it", "difference"])
    details: list[list[str]] = []
    for part, records in found.items():
        if not records:
            continue
        against = _reference(reference) if part == "first32" else beside[part]
        whole, each = ORDER[part](records, against)
        yield from (line([title, *cells]) for title, *cells in whole)
        details.append([f"{part}:", "", *each])
    details.append(list(_fits(_read(folder / FITS))))
    for lines in filter(None, details):
        yield from ("", *lines)
    yield ""
    yield from _made([record for records in [*found.values(), *beside.values()] for record in records.values()])


def mean_text(values: Sequence[float], digits: int = 1, scale: float = 1, *, signed: bool = False) -> str:
    """A mean and its interval, which a single value does not have; empty without values."""
    if not values:
        return ""
    form = f"{'+' if signed else ''}.{digits}f"
    low, high = mean_interval(values)
    interval = f" [{scale * low:{form}}, {scale * high:{form}}]" if len(values) > 1 else ""
    return f"{scale * fmean(values):{form}}{interval}"


def share_within(errors: Sequence[float], pixels: float) -> list[float]:
    """Of each error 1 where it is below, else 0."""
    return [float(error < pixels) for error in errors]


Part = tuple[list[list[str]], list[str]]
"""Rows of the table of all parts; lines of the part's own."""


def _joints(records: Records, chained: Records) -> Part:
    mine, its = (
        {clip: record["metrics"][FIRST][DELTA] for clip, record in each.items()} for each in (records, chained)
    )
    legs, its_legs = ({clip: record[LEGS_NEAR] for clip, record in each.items()} for each in (records, chained))
    whole = [
        [f"joints, < delta_avg, {len(mine)} clips", *_compared(mine, its, 100)],
        [f"joints of legs within 16 px, %, {len(legs)} clips", *_compared(legs, its_legs, 100)],
    ]
    titles = ["clip", "tracks", "< delta_avg", "its tracks' mean", "legs within 16 px"]
    rows = [
        [clip, *_joint_cells(records[clip], mine[clip])]
        + (_joint_cells(chained[clip], its[clip])[1:] if clip in its else [""] * 3)
        for clip in records
    ]
    return whole, [*head([*titles, *(f"chained: {title}" for title in titles[2:])]), *map(line, rows)]


def _joint_cells(record: Record, delta: float) -> list[str]:
    each = record["tracks"]
    return [str(len(each)), f"{100 * delta:.1f}", mean_text(each, scale=100), f"{100 * record[LEGS_NEAR]:.1f}"]


def _ends(records: Records, chained: Records) -> Part:
    mine, its = (
        [error for clip in records if clip in each for error in each[clip]["errors"]] for each in (records, chained)
    )
    whole = []
    for pixels in NEAR:
        one, other = share_within(mine, pixels), share_within(its, pixels)
        apart = [a - b for a, b in zip(one, other, strict=True)] if len(one) == len(other) else []
        texts = mean_text(one, scale=100), mean_text(other, scale=100), mean_text(apart, scale=100, signed=True)
        whole.append([f"ends within {pixels} px, %, {len(mine)} tracks", *texts])
    medians = [f"{median(each):.1f}" if each else "" for each in (mine, its)]
    whole.append(["ends, median error, px", *medians, f"{median(mine) - median(its):+.1f}" if its else ""])
    titles = ["clip", "tracks", *(f"within {pixels}" for pixels in NEAR), "median"]
    rows = [[clip, *_end_cells(records[clip]), *_end_cells(chained.get(clip))] for clip in records]
    return whole, [*head([*titles, *(f"chained: {title}" for title in titles[1:])]), *map(line, rows)]


def _end_cells(record: Record | None) -> list[str]:
    if record is None:
        return [""] * (2 + len(NEAR))
    errors = record["errors"]
    near = [f"{100 * fmean(share_within(errors, pixels)):.0f}" for pixels in NEAR]
    return [str(len(errors)), *near, f"{median(errors):.1f}"]


def _first32(records: Records, reference: Records) -> Part:
    columns, modes = (AJ, POSITION), (STRIDED, FIRST)
    figures = {mode: by_clip(list(records.values()), mode) for mode in modes}
    its = {mode: by_clip(list(reference.values()), mode) for mode in modes}
    whole = []
    for mode in modes:
        for column in columns:
            mine, other = (
                {clip: value for clip, each in values[mode].items() if (value := each[column]) is not None}
                for values in (figures, its)
            )
            whole.append([f"first 32 frames, {column.title}, {mode}, {len(mine)} clips", *_compared(mine, other)])
    titles = [f"{column.title}, {mode}" for mode in modes for column in columns]
    rows = [
        [
            clip,
            *(cell for mode in modes for column in columns for cell in _pair(clip, column, figures[mode], its[mode])),
        ]
        for clip in records
    ]
    return whole, [*head(["clip", *(each for title in titles for each in (title, "32 alone"))]), *map(line, rows)]


def _pair(clip: str, column: Column, mine: ClipValues, its: ClipValues) -> list[str]:
    return [column.text(mine[clip][column]), column.text(its[clip][column]) if clip in its else ""]


def _masks(records: Records, _: Records) -> Part:
    kinds = {"j": "all pixels", "j_seen": "pixels told to be in sight"}
    means = {kind: {clip: fmean(record[kind]) for clip, record in records.items()} for kind in kinds}
    whole = [
        [f"mask of frame 0 carried, J, {title}, {len(records)} clips", mean_text(list(means[kind].values()), 3), "", ""]
        for kind, title in kinds.items()
    ]
    rows = [
        [clip, *(f"{means[kind][clip]:.3f}" for kind in kinds), f"{record['j'][-1]:.3f}", str(record["every"])]
        for clip, record in records.items()
    ]
    return whole, [*head(["clip", *kinds.values(), "all, last frame", "every"]), *map(line, rows)]


def _memory(records: Records, _: Records) -> Part:
    whole = [
        [f"{_size(record)}: peak GiB of decomo-{name}", f"{stage['peak_rss_gib']:.2f}", "", ""]
        for record in records.values()
        for name, stage in record["stages"].items()
    ]
    return whole, list(_stages(records))


def _length(records: Records, _: Records) -> Part:
    ordered = sorted(records.values(), key=lambda record: record["num_frames"])
    whole = []
    for kind, title in (("peak_rss_gib", "peak GiB"), ("peak_disk_gib", "peak GiB of disk")):
        cells = [f"{max(stage[kind] for stage in record['stages'].values()):.2f}" for record in ordered]
        whole.append([f"{_size(ordered[-1])}: {title}", cells[-1], *_shorter(ordered, cells), ""])
    for kind, title in (("seconds", "seconds a frame"), ("cpu_seconds", "processor seconds a frame")):
        values = [_each_frame(record, kind) for record in ordered]
        cells = [f"{value:.2f}" for value in values]
        ratio = f"{values[-1] / values[0]:.2f} times" if len(values) > 1 and values[0] else ""
        whole.append([f"{_size(ordered[-1])}: {title}", cells[-1], *_shorter(ordered, cells), ratio])
    return whole, list(_stages(records))


def _each_frame(record: Record, kind: str) -> float:
    """Of the commands that take the whole clip."""
    return sum(record["stages"][name][kind] for name in ("train", "export", "track")) / record["num_frames"]


def _shorter(ordered: Sequence[Record], cells: Sequence[str]) -> list[str]:
    return [f"{cells[0]} ({ordered[0]['num_frames']} frames)" if len(ordered) > 1 else ""]


def _precision(records: Records, _: Records) -> Part:
    ordered = {way: records[way] for way in ("plain", "refined") if way in records}
    whole = [
        [f"{_size(record)}: median error in px, {title}, {way}", f"{record[kind]['median']:.2f}", "", ""]
        for way, record in ordered.items()
        for kind, title in (("in_sight", "in sight"), ("told_in_sight", "and told so"))
        if record[kind]["median"] is not None
    ]
    titles = ["tracks", "points", "median", "90 %", "of these told in sight", "median", "90 %"]
    rows = [
        [way, *(_figure(record[kind][key]) for kind in ("in_sight", "told_in_sight") for key in record[kind])]
        for way, record in ordered.items()
    ]
    return whole, [*head(titles), *map(line, rows)]


def _figure(value: float | None) -> str:
    return "" if value is None else f"{value:,}" if isinstance(value, int) else f"{value:.2f}"


def _removal(records: Records, _: Records) -> Part:
    whole = []
    for clip, record in records.items():
        work = f"objects removed, {clip}, {record['frames']} frames: processor seconds a frame"
        whole.append([work, f"{record['cpu_seconds_per_frame']:.2f}", "", ""])
    return whole, list(_stages(records))


def _crossing(records: Records, _: Records) -> Part:
    whole, rows = [], []
    for clip, record in records.items():
        windows = f"{record['windows']} windows, copies of one of {clip}"
        work = f"{record['points']:,} points through {windows}: point-frames a second"
        whole.append([work, f"{record['point_frames_per_second']:,}", "", ""])
        rows.append([clip, *(str(record[key]) for key in ("frames", "seconds", "cpu_seconds"))])
    return whole, [*head(["clip", "frames", "seconds", "processor seconds"]), *map(line, rows)]


ORDER = {
    "joints": _joints,
    "ends": _ends,
    "first32": _first32,
    "masks": _masks,
    "memory": _memory,
    "length": _length,
    "precision": _precision,
    "whole": _precision,
    "removal": _removal,
    "crossing": _crossing,
}


def _compared(mine: dict[str, float], its: dict[str, float], scale: float = 1) -> list[str]:
    """Means of both over their clips in common, if any, and of their differences."""
    both = [clip for clip in mine if clip in its]
    texts = [
        mean_text([values[clip] for clip in both or values], scale=scale) for values in (mine, its if both else {})
    ]
    return [*texts, mean_text([mine[clip] - its[clip] for clip in both], scale=scale, signed=True)]


def _stages(records: Records) -> Iterator[str]:
    """A line for each command of each record; of one that went on after a stop, what the last call took."""
    kinds = {
        "seconds": "seconds",
        "cpu_seconds": "processor seconds",
        "peak_rss_gib": "peak GiB",
        "peak_anonymous_gib": "of no file",
        "peak_disk_gib": "GiB of disk",
    }
    yield from head(["clip", "command", *kinds.values()])
    for clip, record in records.items():
        for name, stage in record["stages"].items():
            told = f"{name}, the rest of it" if stage.get("resumed") else name
            yield line([clip, told, *(str(stage.get(kind, "")) for kind in kinds)])


def _fits(records: Records) -> Iterator[str]:
    if not records:
        return
    yield from ("fits:", "")
    yield from head(["clip", "budget", "windows", "steps", "of seconds", "to prepare", "peak GiB", "model MiB"])
    for clip, record in records.items():
        train, export = record["stages"]["train"], record["stages"]["export"]
        counts = [str(train[key]) for key in ("windows", "steps", "fit_seconds", "prepare_seconds")]
        peak = max(train["peak_rss_gib"], export["peak_rss_gib"])
        yield line([clip, record["budget"], *counts, f"{peak:.2f}", f"{record['model_bytes'] / MIB:.1f}"])


def _made(records: Iterable[Record]) -> Iterator[str]:
    """What made the records, each once."""
    made = {
        f"{record['date']}, commit {record['commit']}, {record['machine']['cores']} cores of "
        f"{record['machine']['processor']}, threads: {record['machine']['threads']}"
        for record in records
    }
    yield from sorted(made)


def _size(record: Record) -> str:
    return f"{record['num_frames']:,} frames of {record['width']}x{record['height']}"


def _read(folder: Path) -> Records:
    records = [json.loads(path.read_text()) for path in sorted(folder.glob("*.json"))]
    return {record["clip"]: record for record in records}


def _reference(folder: Path) -> Records:
    """Records by clip and seed; `by_clip` averages the seeds."""
    rows = read_records(folder) if folder.is_dir() else {}
    return {f"{record['clip']} {record['seed']}": record for records in rows.values() for record in records}

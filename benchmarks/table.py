"""Markdown tables of the records that `accuracy.py` and `baselines.py` wrote.

    python benchmarks/table.py benchmarks/results/decomposition                       # a line for each row
    python benchmarks/table.py benchmarks/results/10m --by clip --baseline benchmarks/results/baselines/chained-dis

AJ, < delta_avg and OA in percent, TC in pixels of TAP-Vid's raster. Seeds are averaged within a clip, clips within a
row. Differences are to the baseline on the same clips.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import click

from decomo_eval.query_mode import QUERY_MODES
from decomotion.console import run
from harness.markdown import head, line
from harness.records import Record, read_records
from harness.summary import AJ, COLUMNS, POSITION, ClipValues, by_clip, by_seed, differences, means, worst

COMPARED = (AJ, POSITION)


def row_table(rows: dict[str, list[Record]], query_mode: str, baseline: ClipValues | None) -> Iterator[str]:
    """A line for each row: means over its clips."""
    several_seeds = any(len(by_seed(records, AJ, query_mode)) > 1 for records in rows.values())
    titles = ["row", "clips", *(column.title for column in COLUMNS), "worst clip, AJ"]
    titles += ["AJ by seed"] * several_seeds + ["steps", "peak GiB"]
    if baseline is not None:
        titles += [*(f"difference in {column.title}" for column in COMPARED), "worst difference in AJ"]
    yield from head(titles)
    for name, records in rows.items():
        values = by_clip(records, query_mode)
        average = means(values)
        cells = [name, str(len(values)), *(column.text(average[column]) for column in COLUMNS), _worst(values)]
        if several_seeds:
            cells.append(" / ".join(AJ.text(value) for value in by_seed(records, AJ, query_mode).values()))
        cells += [_steps(records), _peak(records)]
        if baseline is not None:
            apart = differences(values, baseline)
            cells += [column.text(means(apart)[column], signed=True) for column in COMPARED]
            cells.append(_worst(apart, signed=True))
        yield line(cells)


def clip_table(records: list[Record], query_mode: str, baseline: ClipValues | None) -> Iterator[str]:
    """A line for each clip of one row, and their mean."""
    titles = ["clip", *(column.title for column in COLUMNS)]
    if baseline is not None:
        titles += [f"difference in {column.title}" for column in COMPARED]
    yield from head(titles)
    values = by_clip(records, query_mode)
    apart = differences(values, baseline) if baseline is not None else {}
    for clip, figures in [*values.items(), ("**mean**", means(values))]:
        cells = [clip, *(column.text(figures[column]) for column in COLUMNS)]
        if baseline is not None:
            difference = means(apart) if clip == "**mean**" else apart.get(clip)
            cells += [column.text(difference[column], signed=True) if difference else "" for column in COMPARED]
        yield line(cells)


def _worst(values: ClipValues, *, signed: bool = False) -> str:
    found = worst(values, AJ)
    return f"{found[0]}, {AJ.text(found[1], signed=signed)}" if found else ""


def _steps(records: list[Record]) -> str:
    """Least and most steps of the row's fits: what the machine's load and the clips made of the budget."""
    steps = [record["stages"]["train"]["steps"] for record in records if "steps" in record["stages"].get("train", {})]
    return "" if not steps else f"{min(steps):,} to {max(steps):,}" if min(steps) < max(steps) else f"{steps[0]:,}"


def _peak(records: list[Record]) -> str:
    peaks = [stage["peak_rss_gib"] for record in records for stage in record["stages"].values() if len(stage) > 1]
    return f"{max(peaks):.1f}" if peaks else ""


@click.command(context_settings={"show_default": True})
@click.argument("folders", nargs=-1, required=True, type=click.Path(exists=True, path_type=Path))
@click.option("--by", type=click.Choice(["row", "clip"]), default="row")
@click.option("--baseline", type=click.Path(exists=True, path_type=Path), help="Folder of one row's records.")
@click.option("--query-mode", type=click.Choice(QUERY_MODES), default="strided")
def main(folders: tuple[Path, ...], by: str, baseline: Path | None, query_mode: str) -> None:
    """Print the rows of FOLDERS, which hold records at any depth."""
    rows = {name: records for folder in folders for name, records in read_records(folder).items()}
    if not rows:
        raise click.UsageError(f"there are no records in {', '.join(map(str, folders))}")
    compared = None
    if baseline is not None:
        found = list(read_records(baseline).values())
        if len(found) != 1:
            raise click.UsageError(f"{baseline} holds {len(found)} rows; a baseline is the folder of one")
        compared = by_clip(found[0], query_mode)
    if by == "row":
        click.echo("\n".join(row_table(rows, query_mode, compared)))
    else:
        tables = ("\n".join([f"{name}:", "", *clip_table(each, query_mode, compared)]) for name, each in rows.items())
        click.echo("\n\n".join(tables))


if __name__ == "__main__":
    sys.exit(run(main))

"""Plots of records, as PNG: accuracy against the time budget, and rows side by side clip by clip.

    python benchmarks/plots.py budget docs/images/budget.png benchmarks/results/budget benchmarks/results/{3m,10m}/cpu \
        --clips car-shadow,dog --baseline benchmarks/results/baselines/chained-dis
    python benchmarks/plots.py clips docs/images/clips.png benchmarks/results/seeds/cpu \
        benchmarks/results/like-steps/one-volume-1200 benchmarks/results/baselines/{chained,linked}-dis
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from decomotion.cli import Duration
from decomotion.console import run
from decomotion.files import replacing
from harness.records import Record, read_records
from harness.summary import AJ, COLUMNS, POSITION, Column, by_clip, mean

if TYPE_CHECKING:
    from matplotlib.figure import Figure

QUERY_MODE = "strided"
FOLDERS = click.argument("folders", nargs=-1, required=True, type=click.Path(exists=True, path_type=Path))
TITLES = {column.title: column for column in COLUMNS}


def budget_figure(records: Sequence[Record], baseline: Sequence[Record], columns: Sequence[Column]) -> Figure:
    """One panel for each column: a line for each clip over minutes of budget, its baseline as a dashed level."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5 * len(columns), 4), layout="constrained")
    clips = sorted({record["clip"] for record in records})
    levels = by_clip(baseline, QUERY_MODE)
    for axes, column in zip(figure.subplots(1, len(columns), squeeze=False)[0], columns, strict=True):
        for number, clip in enumerate(clips):
            curve = minutes_and_values([record for record in records if record["clip"] == clip], column)
            axes.plot(*zip(*curve, strict=True), marker="o", color=f"C{number}", label=clip)
            if clip in levels and (level := levels[clip][column]) is not None:
                axes.axhline(level, color=f"C{number}", linestyle="--", linewidth=1)
        axes.set_xscale("log")
        axes.set(xlabel="budget, minutes, preparation included", ylabel=column.title)
        ticks = sorted({minutes for minutes, _ in minutes_and_values(records, column)})
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.set_xticks([], minor=True)
        axes.grid(alpha=0.3)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right upper")
    return figure


def minutes_and_values(records: Sequence[Record], column: Column) -> list[tuple[float, float]]:
    """The column's mean at each time budget, budgets growing; records without one are left out."""
    at: dict[float, list[float | None]] = {}
    for record in records:
        if record.get("time_budget"):
            minutes = Duration().convert(record["time_budget"], None, None) / 60
            at.setdefault(minutes, []).append(column.of(record, QUERY_MODE))
    return [(minutes, value) for minutes in sorted(at) if (value := mean(at[minutes])) is not None]


def clips_figure(rows: dict[str, list[Record]], column: Column) -> Figure:
    """A group of bars for each clip that all rows have, a bar for each row."""
    from matplotlib.figure import Figure

    values = {name: by_clip(records, QUERY_MODE) for name, records in rows.items()}
    clips = sorted(set.intersection(*(set(row) for row in values.values())))
    figure = Figure(figsize=(max(6.0, 0.35 * len(clips) * (len(rows) + 1)), 4), layout="constrained")
    axes = figure.subplots()
    width = 0.8 / len(rows)
    for number, (name, row) in enumerate(values.items()):
        shift = (number - (len(rows) - 1) / 2) * width
        heights = {clip: value for clip in clips if (value := row[clip][column]) is not None}
        axes.bar([clips.index(clip) + shift for clip in heights], list(heights.values()), width, label=name)
    axes.set_xticks(range(len(clips)), clips, rotation=30, ha="right")
    axes.set_ylabel(column.title)
    axes.grid(axis="y", alpha=0.3)
    figure.legend(loc="outside right upper")
    return figure


def save(figure: Figure, path: Path) -> None:
    """Writes a PNG, whole or not at all."""
    with replacing(path) as temporary:
        figure.savefig(temporary, format="png", dpi=120)
    click.echo(path)


@click.group()
def main() -> None:
    """Plot records."""


@main.command()
@click.argument("picture", type=click.Path(path_type=Path))
@FOLDERS
@click.option("--clips", "names", help="Names, separated by commas.  [default: all]")
@click.option("--baseline", type=click.Path(exists=True, path_type=Path), help="Folder of one row's records.")
def budget(picture: Path, folders: tuple[Path, ...], names: str | None, baseline: Path | None) -> None:
    """Write PICTURE: accuracy of the records in FOLDERS against their time budgets, rows of one budget together."""
    wanted = names.split(",") if names else None
    records = [
        record
        for folder in folders
        for row in read_records(folder).values()
        for record in row
        if record.get("time_budget") and (wanted is None or record["clip"] in wanted)
    ]
    if not records:
        raise click.UsageError(f"there are no such records with a time budget in {', '.join(map(str, folders))}")
    levels = [record for row in (read_records(baseline) if baseline else {}).values() for record in row]
    save(budget_figure(records, levels, (AJ, POSITION)), picture)


@main.command()
@click.argument("picture", type=click.Path(path_type=Path))
@FOLDERS
@click.option("--metric", type=click.Choice(list(TITLES)), default=AJ.title, show_default=True)
def clips(picture: Path, folders: tuple[Path, ...], metric: str) -> None:
    """Write PICTURE: the rows of FOLDERS side by side, clip by clip."""
    rows = {name: records for folder in folders for name, records in read_records(folder).items()}
    if not rows:
        raise click.UsageError(f"there are no records in {', '.join(map(str, folders))}")
    save(clips_figure(rows, TITLES[metric]), picture)


if __name__ == "__main__":
    sys.exit(run(main))

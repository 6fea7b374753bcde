"""`decomo-bench`: fits, exports and scores every video of a benchmark."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from decomo_eval.columns import COLUMNS
from decomo_eval.names import ORIGINAL, RESOLUTIONS
from decomo_eval.options import dataset_option, listed, query_mode_option
from decomotion import console
from decomotion.jobs.options import chosen_engine, engine_options
from decomotion.options import Duration, prepared_option
from decomotion.presets import AUTO


def _duration(context: click.Context, parameter: click.Parameter, value: str | None) -> str | None:
    """In the user's words, with which the folder is claimed."""
    if value is not None:
        Duration().convert(value, parameter, context)
    return value


@click.command(context_settings={"show_default": True})
@click.argument("dataset", type=click.Path(path_type=Path))
@dataset_option
@click.option("--out", required=True, type=click.Path(file_okay=False, path_type=Path), help="Folder of all results.")
@click.option("--preset", default=AUTO, help="As for decomo-train.")
@click.option(
    "--time-budget", callback=_duration, help="Of each video, as for decomo-train.  [default: decomo-train's]"
)
@click.option("--steps", type=click.IntRange(min=1), help="Of each video, instead of a time.")
@click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help="As for decomo-train.")
@click.option("--seed", type=click.IntRange(min=0, max=2**31 - 1), default=0, help="Of every fit.")
@click.option("--videos", metavar="A,B", help="Fit these only.  [default: all]")
@query_mode_option
@click.option(
    "--resolution",
    type=click.Choice(RESOLUTIONS),
    default=ORIGINAL,
    help="Of the frames that are fitted, as stored or brought to TAP-Vid's 256x256: categories of their own.",
)
@prepared_option
@engine_options("videos")
@click.option("--attempts", type=click.IntRange(min=1), default=2, help="Tries of a video before it is given up.")
def command(
    dataset: Path,
    dataset_name: str | None,
    out: Path,
    preset: str,
    time_budget: str | None,
    steps: int | None,
    overrides: tuple[str, ...],
    seed: int,
    videos: str | None,
    query_mode: str | None,
    resolution: str,
    prepared: str,
    attempts: int,
    **where: Any,
) -> None:
    """Fit, export and score every video of DATASET, a TAP-Vid pickle or a dataset's folder.

    What is finished is not done again: give the same command after an interruption, or to try failed videos once more.
    """
    from decomo_eval.bench.run import bench, command_options
    from decomotion.outputs import check_folder

    if time_budget is not None and steps is not None:
        raise click.UsageError("give --time-budget or --steps, not both")
    check_folder("--out", out)
    options = command_options(preset, time_budget, steps, seed, overrides)
    of_dataset = {"dataset_name": dataset_name, "videos": listed(videos), "resolution": resolution}
    how = {"attempts": attempts, "query_mode": query_mode, "prepared": prepared, "engine": chosen_engine(**where)}
    summary = bench(dataset, out, options, **of_dataset, **how)
    if summary.report is not None:
        cells = ", ".join(f"{column.title} {column.cell(summary.report.mean)}" for column in COLUMNS)
        click.echo(f"{summary.report.query_mode}, mean over {len(summary.report.videos)} videos: {cells}")
        click.echo(f"wrote {out / 'report' / 'index.html'}")
    if summary.hours_for is not None:
        hours = ", ".join(f"{number} videos {hours:g} h" for number, hours in summary.hours_for.items())
        click.echo(f"{summary.seconds_per_video:.0f} s a video: {hours}")
    click.echo(f"{len(summary.finished)} finished, {len(summary.failed)} failed; wrote {out / 'summary.json'}")
    summary.check_finished("videos")


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit code."""
    return console.run(command, argv)

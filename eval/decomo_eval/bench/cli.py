"""`decomo-bench`: fits, exports and scores every video of a benchmark."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click

from decomo_eval.columns import COLUMNS
from decomo_eval.names import ENGINES
from decomo_eval.query_mode import QUERY_MODES, STRIDED
from decomotion import console
from decomotion.errors import TrainingError


@click.command(context_settings={"show_default": True})
@click.argument("dataset", type=click.Path(path_type=Path))
@click.option("--out", required=True, type=click.Path(file_okay=False, path_type=Path), help="Folder of all results.")
@click.option("--preset", default="auto", help="As for decomo-train.")
@click.option("--time-budget", help="Of each video, as for decomo-train.  [default: decomo-train's]")
@click.option("--steps", type=click.IntRange(min=1), help="Of each video, instead of a time.")
@click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help="As for decomo-train.")
@click.option("--seed", type=click.IntRange(min=0), default=0, help="Of every fit.")
@click.option("--videos", metavar="A,B", help="These only.  [default: all]")
@click.option("--query-mode", type=click.Choice(QUERY_MODES), default=STRIDED, help="Of the score.")
@click.option("--engine", type=click.Choice(ENGINES), default=ENGINES[0], help="Where tasks run.")
@click.option("--jobs", type=click.IntRange(min=1), default=1, help="Videos at a time.")
@click.option("--attempts", type=click.IntRange(min=1), default=2, help="Tries of a video before it is given up.")
def command(
    dataset: Path,
    out: Path,
    preset: str,
    time_budget: str | None,
    steps: int | None,
    overrides: tuple[str, ...],
    seed: int,
    videos: str | None,
    query_mode: str,
    engine: str,  # noqa: ARG001  one so far; click has checked it
    jobs: int,
    attempts: int,
) -> None:
    """Fit, export and score every video of DATASET, a TAP-Vid pickle or folder.

    What is finished is not done again: give the same command after an interruption, or to try failed videos once more.
    """
    from decomo_eval.bench.run import bench
    from decomo_eval.bench.task import command_options

    names = None if videos is None else list(dict.fromkeys(name.strip() for name in videos.split(",") if name.strip()))
    options = command_options(preset, time_budget, steps, seed, overrides)
    summary = bench(dataset, out, options, videos=names, jobs=jobs, attempts=attempts, query_mode=query_mode)
    if summary.report is not None:
        cells = ", ".join(f"{column.title} {column.cell(summary.report.mean)}" for column in COLUMNS)
        click.echo(f"{query_mode}, mean over {len(summary.report.videos)} videos: {cells}")
        click.echo(f"wrote {out / 'report' / 'index.html'}")
    click.echo(f"{len(summary.finished)} finished, {len(summary.failed)} failed; wrote {out / 'summary.json'}")
    if summary.failed:
        reasons = "; ".join(f"{outcome.name}: {outcome.error}" for outcome in summary.failed)
        raise TrainingError(f"{len(summary.failed)} videos failed, the same command tries them again ({reasons})")


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit code."""
    return console.run(command, argv)

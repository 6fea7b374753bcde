"""`decomo-batch`: fits, exports and tracks every clip of a folder or list."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from decomotion import console
from decomotion.batch.task import GRID
from decomotion.jobs.options import ENGINE_OPTIONS, chosen_engine, engine_options
from decomotion.options import Duration, forwarded, prepared_option, seed_option, supervision_options, window_options

OWN = ("out", "prepared", "grid", "overlay", "attempts", *ENGINE_OPTIONS)
"""Options that are not decomo-train's."""


@click.command(context_settings={"show_default": True, "help_option_names": ["-h", "--help"]})
@click.argument("clips", metavar="FOLDER|LIST", type=click.Path(path_type=Path))
@click.option("--out", required=True, type=click.Path(file_okay=False, path_type=Path), help="Folder of all results.")
@click.option("--grid", metavar="STEP@T", default=GRID, help="Points to follow: one every STEP pixels of frame T.")
@click.option("--overlay/--no-overlay", default=True, help="Also draw the tracks on each clip.")
@click.option("--time-budget", type=Duration(), help="Of each clip, as for decomo-train.  [default: decomo-train's]")
@click.option("--steps", type=click.IntRange(min=1), help="Of each clip, instead of a time.")
@supervision_options
@window_options
@prepared_option
@seed_option
@click.option("--device", default="auto", help="auto, cpu, cuda or cuda:N.")
@engine_options("clips")
@click.option("--attempts", type=click.IntRange(min=1), default=2, help="Tries of a clip before it is given up.")
@click.pass_context
def command(
    context: click.Context, clips: Path, out: Path, grid: str, overlay: bool, attempts: int, **options: Any
) -> None:
    """Fit, export and track every clip of FOLDER, or of a LIST of paths (.txt, .csv).

    What is done is not done again: give the same command after an interruption, or to try failed clips once more.
    """
    from decomotion.batch.clips import check_common
    from decomotion.batch.run import batch
    from decomotion.outputs import check_folder

    check_common(options)
    check_folder("--out", out)
    engine = chosen_engine(**{name: options[name] for name in ENGINE_OPTIONS})
    asked = {"grid": grid, "overlay": overlay, "attempts": attempts, "prepared": options["prepared"]}
    results = batch(clips, out, forwarded(context, OWN), engine=engine, **asked)
    if results.seconds_per_video is not None:
        click.echo(f"{results.seconds_per_video:.0f} s a clip, {results.jobs} at a time")
    click.echo(f"{len(results.finished)} finished, {len(results.failed)} failed; wrote {out / 'index.html'}")
    results.check_finished("clips")


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit code."""
    return console.run(command, argv)


if __name__ == "__main__":
    sys.exit(main())

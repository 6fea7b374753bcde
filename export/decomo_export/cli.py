"""`decomo-export`: freezes a fitted model into one .onnx file."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from decomotion.console import run as run_command

if TYPE_CHECKING:
    from decomo_export.baking import Bake
    from decomo_export.precision import Precision


@click.command(context_settings={"show_default": True, "help_option_names": ["-h", "--help"]})
@click.argument("model", metavar="MODEL.onnx|DIR", type=click.Path(path_type=Path))
@click.option("--run", type=click.Path(path_type=Path), help="Folder of the run.  [default: the most recent in runs/]")
@click.option(
    "--bake",
    type=click.Choice(["none", "depth", "full"]),
    default="depth",
    help="What of each frame's visible surface is rendered now and kept in the file: nothing, its pseudo-depth, or its "
    "canonical coordinates. The more, the faster the answer and the larger the file.",
)
@click.option(
    "--precision",
    type=click.Choice(["fp32", "fp16", "int8"]),
    default="fp32",
    help="Of the weights in the file; int8 is for the wide layers of the paper preset.",
)
@click.option("--licence", metavar="TEXT", help="Of the clip, in a line, which decomo-info shows: 'CC BY 4.0'.")
@click.option(
    "--force",
    is_flag=True,
    help="Write the file even where its precision moves tracks by more than 0.5 px, or it differs from torch.",
)
def command(model: Path, run: Path | None, bake: Bake, precision: Precision, licence: str | None, force: bool) -> None:
    """Write MODEL.onnx from a run and compare it with torch.

    Of a clip that was fitted as several windows MODEL is a folder, which the other commands take like a file.
    """
    from decomo_export.exporter import SUFFIX, export
    from decomotion.checkpoint import latest_run
    from decomotion.errors import OutputError
    from decomotion.long_clip import read_windows
    from decomotion.outputs import check_folder, check_output
    from decomotion.windows import FILE_NAME

    folder = run if run is not None else latest_run()
    layout, runs, qualities = None, {model: folder}, []
    if (folder / FILE_NAME).is_file():
        layout, *_ = read_windows(folder)
        if model.suffix == SUFFIX:
            several = f"{folder} is of {len(layout.windows)} windows, a file each"
            raise OutputError(f"{several}; give a folder for them, such as {model.with_suffix('')}")
        check_folder("MODEL:", model)
        (model / FILE_NAME).unlink(missing_ok=True)  # until all are there
        runs = {model / f"{window.name}{SUFFIX}": folder / window.name for window in layout.windows}
    else:
        check_output("MODEL.onnx:", model, (SUFFIX,))
    for path, each in runs.items():
        exported = export(path, each, bake=bake, precision=precision, licence=licence, force=force)
        click.echo(
            f"exported {exported.path} ({exported.bytes / 2**20:.1f} MiB); largest difference from torch: "
            f"{exported.parity.pixels:.2g} px in tracks, {exported.parity.score:.2g} in scores"
        )
        if precision != "fp32":
            click.echo(
                f"{precision} weights move tracks by {exported.deviation.mean:.2g} px in the mean, "
                f"{exported.deviation.p99:.2g} px at the 99th percentile"
            )
        qualities.append(exported.quality)
        if exported.thinned is not None:
            click.echo(exported.thinned)
        if exported.quality is None:
            click.echo("how good the fit is was not measured, since it was stopped: end it with decomo-train --resume")
        else:
            click.echo(exported.quality.summary())
            if warning := exported.quality.warning():
                click.echo(f"{warning}; fit for longer")
    if layout is not None:
        replace(layout, quality=tuple(qualities)).save(model / FILE_NAME)
        click.echo(f"wrote {model}, {layout.clip} in {len(layout.windows)} windows")


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    return run_command(command, argv)


if __name__ == "__main__":
    sys.exit(main())

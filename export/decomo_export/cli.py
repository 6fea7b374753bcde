"""`decomo-export`: freezes a fitted model into one .onnx file."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from decomotion.console import run as run_command

if TYPE_CHECKING:
    from decomo_export.baking import Bake
    from decomo_export.precision import Precision


@click.command(context_settings={"show_default": True, "help_option_names": ["-h", "--help"]})
@click.argument("model", metavar="MODEL.onnx", type=click.Path(path_type=Path))
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
@click.option(
    "--force",
    is_flag=True,
    help="Write the file even where its precision moves tracks by more than 0.5 px, or it differs from torch.",
)
def command(model: Path, run: Path | None, bake: Bake, precision: Precision, force: bool) -> None:
    """Write MODEL.onnx from a run and compare it with torch.

    Of a clip that was fitted with --shots split, write one model for each shot: MODEL-shot-000.onnx and so on.
    """
    from decomo_export.exporter import SUFFIX, export
    from decomotion.checkpoint import latest_run
    from decomotion.outputs import check_output
    from decomotion.shots import runs_of_shots

    check_output("MODEL.onnx:", model, (SUFFIX,))
    folder = run if run is not None else latest_run()
    shots = {model.with_stem(f"{model.stem}-{each.name}"): each for each in runs_of_shots(folder)}
    for path, each in (shots or {model: folder}).items():
        exported = export(path, each, bake=bake, precision=precision, force=force)
        click.echo(
            f"exported {exported.path} ({exported.bytes / 2**20:.1f} MiB); largest difference from torch: "
            f"{exported.parity.pixels:.2g} px in tracks, {exported.parity.score:.2g} in scores"
        )
        if precision != "fp32":
            click.echo(
                f"{precision} weights move tracks by {exported.deviation.mean:.2g} px in the mean, "
                f"{exported.deviation.p99:.2g} px at the 99th percentile"
            )
        if exported.thinned is not None:
            click.echo(exported.thinned)
        if exported.quality is None:
            click.echo("how good the fit is was not measured, since it was stopped: end it with decomo-train --resume")
        else:
            click.echo(exported.quality.summary())
            if warning := exported.quality.warning():
                click.echo(f"{warning}; fit for longer")


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    return run_command(command, argv)


if __name__ == "__main__":
    sys.exit(main())

"""`decomo-export`: freezes a fitted model into one .onnx file."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import click

from decomotion.console import run as run_command


@click.command(context_settings={"show_default": True, "help_option_names": ["-h", "--help"]})
@click.argument("model", metavar="MODEL.onnx", type=click.Path(path_type=Path))
@click.option("--run", type=click.Path(path_type=Path), help="Folder of the run.  [default: the most recent in runs/]")
def command(model: Path, run: Path | None) -> None:
    """Write MODEL.onnx from a run and compare it with torch.

    Of a clip that was fitted with --shots split, write one model for each shot: MODEL-shot-000.onnx and so on.
    """
    from decomo_export.exporter import export
    from decomotion.checkpoint import latest_run
    from decomotion.shots import runs_of_shots

    folder = run if run is not None else latest_run()
    shots = {model.with_stem(f"{model.stem}-{each.name}"): each for each in runs_of_shots(folder)}
    for path, each in (shots or {model: folder}).items():
        exported = export(path, each)
        click.echo(
            f"exported {exported.path} ({exported.bytes / 2**20:.1f} MiB); largest difference from torch: "
            f"{exported.parity.pixels:.2g} px in tracks, {exported.parity.score:.2g} in scores"
        )


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    return run_command(command, argv)


if __name__ == "__main__":
    sys.exit(main())

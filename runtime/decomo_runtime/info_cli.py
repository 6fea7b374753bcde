"""`decomo-info`: what a model says about itself."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import click

from decomotion.console import run


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("model", metavar="MODEL.onnx|DIR", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="As JSON, with all figures.")
def info(model: Path, as_json: bool) -> None:
    """Show the card of MODEL: its clip, how it was fitted and exported, and how good it is.

    docs/info.md says what each line means.
    """
    import json

    from decomo_runtime.tracker import Tracker

    card = Tracker(model).card
    click.echo(json.dumps(card.as_json(), indent=2) if as_json else card.as_text())


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    return run(info, argv)


if __name__ == "__main__":
    sys.exit(main())

"""`decomo-flow`: dense correspondence with occlusion, out of an exported model, in files that tools read."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from decomo_runtime.flow.registry import FORMATS
from decomo_runtime.flow.series import ALL, NEXT
from decomotion.console import run

_PATH = click.Path(path_type=Path)


class Frame(click.ParamType):
    """A frame's number, or one of some words."""

    name = "frame"

    def __init__(self, *words: str) -> None:
        self.words = words

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int | str:
        """A usage error where it is neither."""
        if isinstance(value, int) or value in self.words:
            return value
        if not value.isdecimal():
            self.fail(
                f"{value!r} is neither a frame's number, counted from 0, nor {' or '.join(self.words)}", param, ctx
            )
        return int(value)


@click.command(context_settings={"show_default": True})
@click.argument("model", type=_PATH)
@click.option("--from", "origin", required=True, metavar=f"T|{ALL}", type=Frame(ALL), help="Frame of the pixels.")
@click.option(
    "--to",
    "target",
    required=True,
    metavar=f"T|{ALL}|{NEXT}",
    type=Frame(ALL, NEXT),
    help=f"Frame in which they are looked for; {NEXT}: the one after.",
)
@click.option("--both", is_flag=True, help="The opposite direction as well.")
@click.option(
    "--format",
    type=click.Choice([each.name for each in FORMATS]),
    default=FORMATS[0].name,
    help="; ".join(f"{each.name}: {each.purpose}" for each in FORMATS) + ".",
)
@click.option("--out", required=True, metavar="DIR", type=_PATH, help="A new folder: a file for each pair of frames.")
def flow(model: Path, origin: Any, target: Any, both: bool, format: str, out: Path) -> None:
    """Writes where all pixels of a frame are in another, and which are hidden there.

    MODEL is a file, or the folder of a clip of several windows, written by decomo-export. Files are named by the frame
    that changes: DIR/from-00003/00007 leads from frame 3 to frame 7, DIR/to-00003/00007 back, DIR/next/00007 to frame
    8, DIR/previous/00008 back.
    """
    import time

    from decomo_runtime.flow.folder import write_flow
    from decomo_runtime.tracker import Tracker
    from decomotion.outputs import check_new_folder

    check_new_folder("--out", out)
    tracker = Tracker(model)
    start = time.perf_counter()
    written = write_flow(tracker, out, origin, target, format=format, both=both, progress=True)
    click.echo(
        f"{written.pairs} pair{'s' * (written.pairs != 1)} of frames of {tracker.clip_name}, "
        f"{written.occluded:.0%} occluded, {time.perf_counter() - start:.2f} s"
    )
    click.echo(f"wrote {out}")


def main(argv: Sequence[str] | None = None) -> int:
    """Runs `decomo-flow` on `argv` and returns its exit code."""
    return run(flow, argv)

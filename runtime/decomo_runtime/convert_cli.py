"""`decomo-convert`: writes tracks as the file that another tool reads."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import click

from decomo_runtime.formats.registry import FORMATS
from decomotion.console import run

_PATH = click.Path(path_type=Path)


_FORMATS = "\n".join(["\b", "Formats:", *(f"  {each.name:22}{each.kind:8}{each.purpose}" for each in FORMATS)])


@click.command(context_settings={"show_default": True}, epilog=_FORMATS)
@click.argument("tracks", type=_PATH)
@click.argument("out", type=_PATH)
@click.option("--to", metavar="NAME", show_default="by the ending of OUT", help="The format, by its name below.")
@click.option("--size", metavar="WxH", help="Of the clip's frames in pixels, where TRACKS does not say.")
@click.option("--fps", type=float, metavar="RATE", help="Frames a second, where TRACKS does not say.")
@click.option("--first-frame", type=int, metavar="N", help="What the tool calls the clip's first frame.")
@click.option("--clip", metavar="CLIP", type=_PATH, help="Frames or video: says size and rate, and where they are.")
def convert(
    tracks: Path,
    out: Path,
    to: str | None,
    size: str | None,
    fps: float | None,
    first_frame: int | None,
    clip: Path | None,
) -> None:
    """Writes TRACKS, a file of decomo-track or of decomo-view's page, as the file OUT that another tool reads.

    docs/convert.md says what becomes of coordinates, frame numbers and hidden points in each.
    """
    from decomo_runtime.formats.convert import convert as convert_tracks
    from decomo_runtime.formats.registry import format_of
    from decomotion.outputs import check_new_folder, check_not_input, check_output

    wanted = format_of(out, to)
    (check_new_folder if wanted.folder else check_output)("OUT", out)
    check_not_input("OUT", out, tracks, clip)
    found = convert_tracks(tracks, out, to, size=_size(size), fps=fps, first_frame=first_frame, clip=clip)
    number, length = found.occluded.shape
    click.echo(f"{number} point{'s' * (number != 1)} in {length} frame{'s' * (length != 1)}, for {wanted.purpose}")
    click.echo(f"wrote {out}")


def _size(text: str | None) -> tuple[int, int] | None:
    """`"640x360"`, width first, as (height, width)."""
    if text is None:
        return None
    from decomo_runtime.errors import TracksFileError

    match = re.fullmatch(r"([1-9]\d{0,6})[xX]([1-9]\d{0,6})", text)
    if match is None:
        raise TracksFileError(f"--size {text} is not WIDTHxHEIGHT in pixels, such as 640x360")
    return int(match[2]), int(match[1])


def main(argv: Sequence[str] | None = None) -> int:
    """Runs `decomo-convert` on `argv` and returns its exit code."""
    return run(convert, argv)

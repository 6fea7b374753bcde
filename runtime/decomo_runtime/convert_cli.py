"""`decomo-convert`: writes tracks as the file that another tool reads."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import click

from decomo_runtime.formats.registry import FORMATS
from decomotion.console import run

_PATH = click.Path(path_type=Path)


CORRECTIONS = "corrections"
"""For `--to`: made of keypoints and not of tracks."""
_OF_KEYPOINTS = CORRECTIONS, ".csv", "decomo-train --corrections; KEYPOINTS in place of TRACKS"
_LINES = [*((each.name, each.kind, each.purpose) for each in FORMATS), _OF_KEYPOINTS]
_FORMATS = "\n".join(["\b", "Formats:", *(f"  {name:22}{kind:13}{purpose}" for name, kind, purpose in _LINES)])


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

    With --to corrections TRACKS is a file of keypoints, DeepLabCut's (.csv, .h5) or COCO's (.json).

    docs/convert.md says what becomes of coordinates, frame numbers and hidden points in each.
    """
    from decomo_runtime.formats.convert import convert as convert_tracks
    from decomo_runtime.formats.registry import format_of
    from decomotion.outputs import check_new_folder, check_not_input, check_output

    if to == CORRECTIONS:
        check_output("OUT", out, (".csv",))
        check_not_input("OUT", out, tracks, clip)
        _convert_keypoints(tracks, out, clip)
        return
    wanted = format_of(out, to)
    (check_new_folder if wanted.folder else check_output)("OUT", out)
    check_not_input("OUT", out, tracks, clip)
    found = convert_tracks(tracks, out, to, size=_size(size), fps=fps, first_frame=first_frame, clip=clip)
    number, length = found.occluded.shape
    click.echo(f"{number} point{'s' * (number != 1)} in {length} frame{'s' * (length != 1)}, for {wanted.purpose}")
    click.echo(f"wrote {out}")


def _convert_keypoints(keypoints: Path, out: Path, clip: Path | None) -> None:
    from decomo_runtime.formats.corrections import convert_keypoints
    from decomo_runtime.formats.frames import clip_files

    files = () if clip is None else [file.name for file in clip_files(clip)]
    points, lines = convert_keypoints(keypoints, out, files)
    click.echo(f"{lines} correction{'s' * (lines != 1)} of {points} point{'s' * (points != 1)}")
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

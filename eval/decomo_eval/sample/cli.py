"""`decomo-sample`: writes a procedural clip with exact ground truth."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click

from decomotion.console import run


@click.command(context_settings={"show_default": True})
@click.argument("directory", metavar="DIR", type=click.Path(path_type=Path))
@click.option("--seed", default=0, help="Number that decides the whole scene, 0 or more.")
@click.option("--frames", default=24, help="Frames in the clip; the motion is spread over them.")
@click.option("--size", default=256, help="Width and height of a frame, pixels.")
@click.option("--force", is_flag=True, help="Replace clip/, masks/ and sample.pkl where DIR has them already.")
def command(directory: Path, seed: int, frames: int, size: int, force: bool) -> None:
    """Write a procedural clip with exact ground truth into DIR.

    A textured scene under a moving camera, with non-rigid objects that occlude one another and leave the frame:
    DIR/clip (frames), DIR/masks (255 = moving object) and DIR/sample.pkl (tracks, in TAP-Vid's form).
    """
    from decomo_eval.sample import generate, write

    sample = generate(seed, frames, size)
    written = write(sample, directory, force=force)
    hidden = sample.occluded.mean()
    click.echo(f"{frames} frames of {size}x{size}, {len(sample.points)} tracks ({hidden:.0%} occluded)")
    for path in written:
        click.echo(path)


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command and returns its exit code."""
    return run(command, argv)


if __name__ == "__main__":
    raise SystemExit(main())

"""A small picture of a clip, three of its frames side by side: a stage of its own, as decoding may end a process."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import click
import cv2
import numpy as np

from decomotion.clip import Clip, read_clip
from decomotion.console import run
from decomotion.files import replacing
from decomotion.images import jpeg

SIDE, QUALITY = 192, 80
"""Longer side of each frame in pixels, and how well the JPEG is kept."""
PLACES = (1 / 6, 1 / 2, 5 / 6)
"""Of the frames in the clip."""


def strip(clip: Clip) -> np.ndarray:
    """RGB uint8 [h, 3 * w, 3], as the clip is to be shown: its pixels are square here."""
    width, height = clip.width * clip.pixel_aspect, clip.height
    scale = min(1.0, SIDE / max(width, height))
    size = max(1, round(width * scale)), max(1, round(height * scale))
    frames = [np.asarray(clip.frames[int(place * len(clip))]) for place in PLACES]
    return np.hstack([cv2.resize(frame, size, interpolation=cv2.INTER_AREA) for frame in frames])


@click.command()
@click.argument("clip", type=click.Path(path_type=Path))
@click.argument("out", metavar="JPG", type=click.Path(path_type=Path))
def command(clip: Path, out: Path) -> None:
    """Write a small picture of CLIP."""
    picture = jpeg(strip(read_clip(clip)), QUALITY)
    with replacing(out) as file:
        file.write_bytes(picture)


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit code."""
    return run(command, argv)


if __name__ == "__main__":
    sys.exit(main())

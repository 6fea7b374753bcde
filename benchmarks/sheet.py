"""Sheets of layers, as in docs/render.md: a clip beside all that a model makes of it, a row for each frame.

    python benchmarks/sheet.py ../shared/data/tapvid_davis32_dev.pkl runs/cpu --out sheets --frames 2,16,29

Models are `.onnx` files, or folders that hold some; each says in its metadata which clip it is of and gets one picture,
`<clip>.jpg`. Columns: the clip, fused, static scene, objects, motion mask, pseudo-depth, the clip without its objects.
"""

from __future__ import annotations

import sys
from pathlib import Path

import click
import cv2
import numpy as np

from decomo_runtime import Tracker
from decomo_runtime.layers import LAYERS, render
from decomo_runtime.pictures import flattened, tiled
from decomo_runtime.removal import remove_objects
from decomotion.console import run
from decomotion.files import replacing
from decomotion.frames import AnyFrames
from decomotion.images import jpeg
from harness.clips import read_clips
from harness.models import model_files

TITLES = ("clip", "fused", "static", "objects", "mask", "depth", "removed")
HEADING = 26
QUALITY = 85


@click.command(context_settings={"show_default": True})
@click.argument("dataset")
@click.argument("models", nargs=-1, required=True, type=click.Path(exists=True, path_type=Path))
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder of the pictures.")
@click.option("--frames", default="0", help="Separated by commas.")
@click.option("--width", default=1680, help="Of the picture, in pixels.")
def main(dataset: str, models: tuple[Path, ...], out: Path, frames: str, width: int) -> None:
    """Draw what MODELS make of the clips of DATASET, a TAP-Vid pickle."""
    wanted = [int(frame) for frame in frames.split(",")]
    for path in model_files(models):
        tracker = Tracker(path)
        video = read_clips(dataset, [tracker.clip_name])[tracker.clip_name].video.frames()
        picture = out / f"{tracker.clip_name}.jpg"
        with replacing(picture) as temporary:
            temporary.write_bytes(jpeg(sheet(tracker, video, wanted, width), QUALITY))
        click.echo(f"wrote {picture}")


def sheet(tracker: Tracker, video: AnyFrames, wanted: list[int], width: int) -> np.ndarray:
    """The sheet of one clip [T, H, W, 3], `width` pixels wide: RGB."""
    pictures = []
    for frame, removed in zip(wanted, remove_objects(tracker, video, wanted), strict=True):
        pictures += [video[frame], *map(flattened, render(tracker, frame, LAYERS)), removed]
    tiles = tiled(pictures, len(TITLES))
    size = (width, round(width * tiles.shape[0] / tiles.shape[1]))
    tiles = cv2.resize(tiles, size, interpolation=cv2.INTER_AREA if width < tiles.shape[1] else cv2.INTER_CUBIC)
    heading = np.full((HEADING, width, 3), 255, np.uint8)
    for column, title in enumerate(TITLES):
        place = (column * width // len(TITLES) + 6, 19)
        cv2.putText(heading, title, place, cv2.FONT_HERSHEY_SIMPLEX, 0.55, (0, 0, 0), 1, cv2.LINE_AA)
    return np.concatenate([heading, tiles.astype(np.uint8)])


if __name__ == "__main__":
    sys.exit(run(main))

"""The README's picture of layers: a clip beside all that a model makes of it, a row for each frame.

    python benchmarks/sheet.py models/car-shadow.onnx car-shadow docs/images/layers.jpg --frames 2,16,29

Columns: the clip, fused, static scene, objects, motion mask, pseudo-depth, the clip without its objects.
"""

from __future__ import annotations

from pathlib import Path

import click
import cv2
import numpy as np

from decomo_runtime import Tracker
from decomo_runtime.pictures import flattened, tiled
from decomo_runtime.removal import remove_objects
from decomo_runtime.rendering import LAYERS, render
from decomotion.clip import read_clip
from decomotion.files import replacing

TITLES = ("clip", "fused", "static", "objects", "mask", "depth", "removed")
HEADING = 26


@click.command(context_settings={"show_default": True})
@click.argument("model", type=click.Path(exists=True, path_type=Path))
@click.argument("clip", type=click.Path(path_type=Path))
@click.argument("picture", type=click.Path(path_type=Path))
@click.option("--frames", default="0", help="Separated by commas.")
@click.option("--width", default=1680, help="Of the picture, in pixels.")
def main(model: Path, clip: Path, picture: Path, frames: str, width: int) -> None:
    tracker, video, wanted = Tracker(model), read_clip(clip).frames, [int(frame) for frame in frames.split(",")]
    pictures = []
    for frame, removed in zip(wanted, remove_objects(tracker, video, wanted), strict=True):
        pictures += [video[frame], *map(flattened, render(tracker, frame, LAYERS)), removed]
    sheet = tiled(pictures, len(TITLES))
    size = (width, round(width * sheet.shape[0] / sheet.shape[1]))
    sheet = cv2.resize(sheet, size, interpolation=cv2.INTER_AREA if width < sheet.shape[1] else cv2.INTER_CUBIC)
    heading = np.full((HEADING, width, 3), 255, np.uint8)
    for column, title in enumerate(TITLES):
        place = (column * width // len(TITLES) + 6, 19)
        cv2.putText(heading, title, place, cv2.FONT_HERSHEY_SIMPLEX, 0.55, (0, 0, 0), 1, cv2.LINE_AA)
    drawn = cv2.cvtColor(np.concatenate([heading, sheet.astype(np.uint8)]), cv2.COLOR_RGB2BGR)
    with replacing(picture) as temporary:
        cv2.imwrite(str(temporary), drawn, [cv2.IMWRITE_JPEG_QUALITY, 85])


if __name__ == "__main__":
    main()

"""A picture of tracks, that of docs/index.md: four frames of a clip with the tracks of a grid of points.

python benchmarks/picture.py models/sample.onnx sample/clip docs/images/tracks.png --grid 16@0
"""

from __future__ import annotations

from pathlib import Path

import click
import cv2
import numpy as np

from decomo_runtime import Tracker
from decomo_runtime.overlay import contact_sheet, draw_tracks
from decomo_runtime.pictures import write_png
from decomo_runtime.queries import grid_queries, parse_grid
from decomotion.clip import read_clip


@click.command(context_settings={"show_default": True})
@click.argument("model", type=click.Path(exists=True, path_type=Path))
@click.argument("clip", type=click.Path(exists=True, path_type=Path))
@click.argument("picture", type=click.Path(path_type=Path))
@click.option("--grid", default="16@0", help="STEP@T, as for decomo-track.")
@click.option("--frames", default=4, help="Frames shown, evenly spaced.")
@click.option("--width", default=1400, help="Of the picture, in pixels.")
def main(model: Path, clip: Path, picture: Path, grid: str, frames: int, width: int) -> None:
    tracker = Tracker(model)
    tracks = tracker.track(grid_queries(*parse_grid(grid), tracker.height, tracker.width))
    drawn = list(draw_tracks(read_clip(clip).frames, tracks))
    shown = np.linspace(0, len(drawn) - 1, frames).round().astype(int)
    sheet = contact_sheet([drawn[index] for index in shown])
    size = (width, round(width * sheet.shape[0] / sheet.shape[1]))
    write_png(picture, cv2.resize(sheet, size, interpolation=cv2.INTER_AREA).astype(np.uint8))


if __name__ == "__main__":
    main()

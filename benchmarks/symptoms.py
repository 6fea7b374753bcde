"""Pictures of what goes wrong, for docs/troubleshooting.md. The page names the command of each.

python benchmarks/symptoms.py mask horsejump-high.onnx davis480p/frames/horsejump-high 25 swallowed.jpg
python benchmarks/symptoms.py error lab-coat.onnx lab-coat 4 24 flat.jpg
python benchmarks/symptoms.py truth sample 0 12 starved.jpg few.onnx enough.onnx
python benchmarks/symptoms.py blurred davis480p/frames/parkour@0:30 10 20 parkour-blurred cut.jpg
"""

from __future__ import annotations

import sys
from pathlib import Path

import click
import cv2
import numpy as np

from decomo_eval import read_dataset
from decomo_runtime import Tracker
from decomo_runtime.errors import TracksFileError
from decomo_runtime.layers import render
from decomotion.clip import read_clip
from decomotion.console import run
from decomotion.files import replacing
from decomotion.images import jpeg

_PATH = click.Path(path_type=Path)
HEIGHT, QUALITY, GAP = 320, 80, 6
"""Of the pictures, pixels; of their JPEG; between two of them."""
GRID, WORST = 9, 12.0
"""Pixels between points, of a frame whose longer side is 256; the error of the last colour, in pixels of the clip."""


@click.group()
def main() -> None:
    """Draw a symptom."""


@main.command()
@click.argument("model", type=_PATH)
@click.argument("clip", type=_PATH)
@click.argument("frame", type=int)
@click.argument("out", type=_PATH)
def mask(model: Path, clip: Path, frame: int, out: Path) -> None:
    """A frame, and beside it what MODEL takes for an object there."""
    (moving,) = render(Tracker(model), frame, ["mask"], long_side=427)
    _save(out, [read_clip(clip).frames[frame], moving])


@main.command()
@click.argument("model", type=_PATH)
@click.argument("clip", type=_PATH)
@click.argument("start", type=int)
@click.argument("frame", type=int)
@click.argument("out", type=_PATH)
def error(model: Path, clip: Path, start: int, frame: int, out: Path) -> None:
    """Points of START, and where MODEL has them in FRAME: the more yellow, the larger the error that it tells."""
    tracker, frames = Tracker(model), read_clip(clip).frames
    step = GRID * max(tracker.width, tracker.height) / 256
    x, y = np.meshgrid(np.arange(step / 2, tracker.width, step), np.arange(step / 2, tracker.height, step))
    queries = np.stack([np.full(x.size, start), x.ravel(), y.ravel()], axis=1).astype(np.float32)
    tracks = tracker.track(queries, [start, frame])
    if tracks.error is None:
        raise TracksFileError(f"{model} tells no errors; export it anew")
    shades = np.clip(255 * tracks.error / WORST, 0, 255).astype(np.uint8)
    pictures = []
    for column, number in enumerate((start, frame)):
        picture, scale = _enlarged(frames[number])
        colours = cv2.applyColorMap(shades[:, 1:], cv2.COLORMAP_VIRIDIS)[:, 0, ::-1]
        for row in np.flatnonzero(~tracks.occluded[:, 1]):
            _disc(picture, tracks.xy[row, column], scale, colours[row])
        pictures.append(picture)
    _save(out, pictures)


@main.command()
@click.argument("sample", type=_PATH)
@click.argument("start", type=int)
@click.argument("frame", type=int)
@click.argument("out", type=_PATH)
@click.argument("models", nargs=-1, required=True, type=_PATH)
def truth(sample: Path, start: int, frame: int, out: Path, models: tuple[Path, ...]) -> None:
    """Points of START in FRAME, by each of MODELS: a disc, and a line to where the point is by truth."""
    (video,) = read_dataset(str(sample / "sample.pkl")).values()
    frames = video.frames()
    both = ~video.occluded[:, start] & ~video.occluded[:, frame]
    places = video.points[both] * (video.width, video.height) - 0.5
    pictures = []
    for model in models:
        queries = np.column_stack([np.full(len(places), start), places[:, start]]).astype(np.float32)
        answers = Tracker(model).track(queries, [frame]).xy[:, 0]
        picture, scale = _enlarged(frames[frame])
        for answer, true in zip(answers, places[:, frame], strict=True):
            ends = [tuple(int(v) for v in np.round((each + 0.5) * scale)) for each in (answer, true)]
            cv2.line(picture, ends[0], ends[1], (255, 255, 0), 2, cv2.LINE_AA)
            _disc(picture, answer, scale, (255, 60, 60))
        pictures.append(picture)
    _save(out, pictures)


@main.command()
@click.argument("clip", type=_PATH)
@click.argument("begin", type=int)
@click.argument("end", type=int)
@click.argument("folder", type=_PATH)
@click.argument("out", type=_PATH)
def blurred(clip: Path, begin: int, end: int, folder: Path, out: Path) -> None:
    """Write CLIP with frames from BEGIN up to but without END out of focus as FOLDER; draw one before, in and after."""
    frames = list(read_clip(clip).frames)
    for number in range(begin, end):
        soft = cv2.GaussianBlur(frames[number], (0, 0), frames[number].shape[1] / 17)
        frames[number] = soft.astype(np.uint8)
    folder.mkdir(parents=True)
    for number, frame in enumerate(frames):
        (folder / f"{number:05}.jpg").write_bytes(jpeg(frame, 95))
    _save(out, [frames[number] for number in (begin - 1, (begin + end) // 2, end)])


def _enlarged(frame: np.ndarray) -> tuple[np.ndarray, float]:
    scale = HEIGHT / frame.shape[0]
    size = (round(frame.shape[1] * scale), HEIGHT)
    method = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    return np.ascontiguousarray(cv2.resize(frame, size, interpolation=method)), scale


def _disc(picture: np.ndarray, place: np.ndarray, scale: float, colour: np.ndarray | tuple[int, int, int]) -> None:
    centre = tuple(int(value) for value in np.round((place + 0.5) * scale))
    cv2.circle(picture, centre, 4, (0, 0, 0), -1, cv2.LINE_AA)
    cv2.circle(picture, centre, 3, tuple(int(value) for value in colour), -1, cv2.LINE_AA)


def _save(out: Path, pictures: list[np.ndarray]) -> None:
    rows = [_enlarged(each)[0] for each in pictures]
    gap = np.full((HEIGHT, GAP, 3), 255, np.uint8)
    parts = [part for row in rows for part in (gap, row)][1:]
    with replacing(out) as temporary:
        temporary.write_bytes(jpeg(np.concatenate(parts, axis=1), QUALITY))
    click.echo(f"wrote {out}")


if __name__ == "__main__":
    sys.exit(run(main))

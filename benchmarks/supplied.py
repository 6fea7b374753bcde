"""What a user might supply in place of our estimators, for clips with ground truth: for `series/supplied.yaml`.

    python benchmarks/supplied.py ../shared/data/tapvid_davis32_dev.pkl ../shared/data/davis32_dev_mask.npz supplied \
        --models models --clips dog,horsejump-high

Into OUT/<clip>: `masks`, those that people drew (DAVIS); `flow`, OpenCV's DIS with its `medium` preset on the frames as
they are, at gaps 1, 2, 4 and 8; and, with `--models`, `tracks.npz`, those of <clip>.onnx there on a grid of points.
"""

from __future__ import annotations

import sys
from pathlib import Path

import click
import cv2
import numpy as np
from PIL import Image

from decomo_runtime import Tracker
from decomotion.console import run
from decomotion.data.links.intervals import pairs_of
from harness.clips import BenchmarkClip, read_clips

GAPS = (1, 2, 4, 8)
ASKED_EVERY, GRID = 10, 16
"""Tracks begin in every tenth frame, a point every 16 pixels."""


def write_masks(clip: BenchmarkClip, folder: Path) -> None:
    """A PNG a frame, white where an object moves."""
    assert clip.object_masks is not None
    folder.mkdir(parents=True, exist_ok=True)
    for number, mask in enumerate(clip.object_masks):
        Image.fromarray(mask).save(folder / f"{number:05d}.png")


def write_flow(clip: BenchmarkClip, folder: Path) -> None:
    """`<i>_<j>.npy` for every pair at the gaps, both ways."""
    folder.mkdir(parents=True, exist_ok=True)
    estimator = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    grey = [cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY) for frame in clip.video.frames()]
    for first, second in pairs_of(GAPS, len(grey)):
        flow = estimator.calc(grey[first], grey[second], np.zeros((*grey[first].shape, 2), np.float32))
        np.save(folder / f"{first}_{second}.npy", flow)


def write_tracks(clip: BenchmarkClip, model: Path, file: Path) -> None:
    """The model's tracks of a grid of points in some frames."""
    video = clip.video
    t, y, x = np.mgrid[
        0 : video.num_frames : ASKED_EVERY, GRID // 2 : video.height : GRID, GRID // 2 : video.width : GRID
    ]
    Tracker(model).track(np.stack([t, x, y], -1).reshape(-1, 3).astype(np.float32)).save(file)


@click.command(context_settings={"show_default": True})
@click.argument("dataset")
@click.argument("object_masks", type=click.Path(exists=True, path_type=Path))
@click.argument("out", type=click.Path(path_type=Path))
@click.option("--models", type=click.Path(exists=True, path_type=Path), help="Folder of <clip>.onnx.")
@click.option("--clips", help="Names, separated by commas.  [default: all]")
def main(dataset: str, object_masks: Path, out: Path, models: Path | None, clips: str | None) -> None:
    """Write masks, flow and tracks for the clips of DATASET, a TAP-Vid pickle."""
    for name, clip in read_clips(dataset, clips.split(",") if clips else None, object_masks).items():
        write_masks(clip, out / name / "masks")
        write_flow(clip, out / name / "flow")
        if models is not None:
            write_tracks(clip, models / f"{name}.onnx", out / name / "tracks.npz")
        click.echo(out / name)


if __name__ == "__main__":
    sys.exit(run(main))

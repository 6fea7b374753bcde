"""Rendering of fitted models against the clips: PSNR of the fused picture, IoU of the motion mask. One record a model.

    python benchmarks/rendering.py ../shared/data/tapvid_davis32_dev.pkl ../shared/data/davis32_dev_mask.npz \
        runs/cpu --out benchmarks/results/rendering

Models are `.onnx` files, or folders that hold some, for instance what `accuracy.py --work` left. The second file holds
a boolean array [frame, H, W] for each clip of the first, by name; each model says in its metadata which clip it is of.
Both figures are means over frames; a pixel of the rendered mask moves where its static confidence is below one half.
What has a record is not rendered again. At the end the mean over the clips.
"""

from __future__ import annotations

import hashlib
import json
import sys
import time
from pathlib import Path
from statistics import fmean

import click
import numpy as np

from decomo_runtime import Tracker, render
from decomotion.console import run
from decomotion.frames import AnyFrames
from harness.clips import read_clips
from harness.models import model_files
from harness.pictures import intersection_over_union, psnr
from harness.records import Record, is_done, provenance, write_record


def measure(tracker: Tracker, clip: AnyFrames, truth: np.ndarray, frames: range) -> Record:
    """`psnr` in dB and `mask_iou` over `frames` of the clip [T, H, W, 3] and its true masks [T, H, W]."""
    noise, overlap = [], []
    for frame in frames:
        fused, mask = render(tracker, frame, ["fused", "mask"])
        noise.append(psnr(fused, clip[frame]))
        overlap.append(intersection_over_union((mask[..., 0] > 127)[None], truth[frame : frame + 1]))
    return {"psnr": fmean(noise), "mask_iou": fmean(overlap)}


@click.command(context_settings={"show_default": True})
@click.argument("dataset", type=click.Path(exists=True, path_type=Path))
@click.argument("masks", type=click.Path(exists=True, path_type=Path))
@click.argument("models", nargs=-1, required=True, type=click.Path(exists=True, path_type=Path))
@click.option("--every", default=1, type=click.IntRange(min=1), help="Render every so many frames.")
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder of the records.")
def main(dataset: Path, masks: Path, models: tuple[Path, ...], every: int, out: Path) -> None:
    """Render the clips of DATASET from MODELS; MASKS are those drawn by hand."""
    click.echo("| clip | PSNR dB | mask IoU | frames |\n|---|---|---|---|")
    rows = []
    for path in model_files(models):
        tracker = Tracker(path)
        facts = {
            "clip": tracker.clip_name,
            "model": hashlib.sha256(path.read_bytes()).hexdigest()[:12],
            "every": every,
        }
        record_path = out / f"{tracker.clip_name}.json"
        if is_done(record_path, facts):
            rows.append(_row(json.loads(record_path.read_text())))
            continue
        clip = read_clips(str(dataset), [tracker.clip_name], masks)[tracker.clip_name]
        if clip.object_masks is None:
            raise click.UsageError(f"{masks} has no masks of {tracker.clip_name}")
        begin, frames = time.monotonic(), range(0, tracker.num_frames, every)
        about = {**facts, "preset": tracker.preset, "frames": len(frames), "dataset": dataset.name, **provenance()}
        figures = measure(tracker, clip.video.frames(), clip.object_masks, frames)
        seconds = round((time.monotonic() - begin) / len(frames), 2)
        record = {**about, "seconds_per_frame": seconds, "rendering": figures}
        write_record(record_path, record)
        rows.append(_row(record))
    if len(rows) > 1:
        click.echo("| mean | {:.1f} | {:.3f} | |".format(*map(fmean, zip(*rows, strict=True))))


def _row(record: Record) -> tuple[float, float]:
    """PSNR and IoU of a record, printed."""
    psnr, overlap = record["rendering"]["psnr"], record["rendering"]["mask_iou"]
    click.echo(f"| {record['clip']} | {psnr:.1f} | {overlap:.3f} | {record['frames']} |")
    return psnr, overlap


if __name__ == "__main__":
    sys.exit(run(main))

"""Tracks before and after `Tracker.refine`: errors in pixels of large procedural clips, and on real ones.

    python benchmarks/refinement.py procedural 24 1920 1080 --seed 3 --work runs/refinement --out RECORDS
    python benchmarks/refinement.py procedural 60 3840 2160 --seed 4 --fitted-to 640 --work WORK --out RECORDS
    python benchmarks/refinement.py davis ../shared runs/cpu --dataset first32.pkl --out RECORDS

The first draws a clip of that many frames, that wide and high (`harness/scenery.py`), fits a model to it, or to a copy
of the width `--fitted-to`, in few steps, and compares its answers with the exact truth. What exists in `--work` is not
made again. The second takes models of TAP-Vid's first 32 frames at 256x256, `.onnx` files or folders that hold some,
for instance what `accuracy.py --work` left, and asks them in the same frames at 854x480; `< delta_avg` is TAP-Vid's, of
queries in every fifth frame. Errors are of points that are in sight by truth and by the model, outside of the queries'
own frames.
"""

from __future__ import annotations

import hashlib
import time
from pathlib import Path

import click
import cv2
import numpy as np
import numpy.typing as npt

from decomo_eval.dataset import read_dataset
from decomo_eval.metrics import THRESHOLDS
from decomo_runtime.refinement import AnyTracker, refine
from decomotion.frame_files import frame_files, open_frames
from decomotion.frames import Frames
from harness.fitted import fitted_model, written
from harness.models import model_files
from harness.records import Record, provenance, write_record
from harness.reduced import ReducedTracker
from harness.scenery import Scenery

_PATH = click.Path(path_type=Path)
RASTER = 256
"""Pixels, of TAP-Vid's frames."""
STRIDE = 5
"""Frames between queries of a point, as TAP-Vid's mode `strided` has them."""


@click.group()
def main() -> None:
    """Measure what refinement on the clip's own pixels brings."""
    cv2.setNumThreads(1)


@main.command(context_settings={"show_default": True})
@click.argument("frames", type=click.IntRange(min=2))
@click.argument("width", type=click.IntRange(min=32))
@click.argument("height", type=click.IntRange(min=32))
@click.option("--seed", default=0, help="Of the scene.")
@click.option("--fitted-to", type=int, help="Width of the copy that the model is fitted to.  [default: the clip's]")
@click.option("--steps", default=500, help="Of the fit.")
@click.option("--points", default=600, help="Queries, half in the first frame and half in the middle.")
@click.option("--work", type=_PATH, required=True, help="Folder for clips, runs and models.")
@click.option("--out", type=_PATH, required=True, help="Folder of the records.")
def procedural(
    frames: int,
    width: int,
    height: int,
    seed: int,
    fitted_to: int | None,
    steps: int,
    points: int,
    work: Path,
    out: Path,
) -> None:
    """Refine tracks of a procedural clip whose truth is known."""
    scenery = Scenery(frames, width, height, seed)
    clip = written(scenery, work)
    fitted = clip if fitted_to is None else written(Scenery(frames, fitted_to, fitted_to * height // width, seed), work)
    model = fitted_model(fitted, steps, work)
    rng = np.random.default_rng(seed)
    t = np.repeat([0, frames // 2], (points // 2, points - points // 2))
    queries = np.stack([t, rng.uniform(0, width - 1, points), rng.uniform(0, height - 1, points)], axis=1)
    truth, occluded = scenery.follow(queries)
    tracker = ReducedTracker(model, width, height)
    record, _ = _compared(tracker, queries, np.arange(frames), open_frames(frame_files(clip)[:frames]), truth, occluded)
    facts = {"clip": scenery.name, "fitted_to": fitted.name, "steps": steps, "points": points, "model": _hash(model)}
    write_record(out / f"{scenery.name}.json", facts | record | provenance())
    click.echo(f"{scenery.name}: {_told(record)}")


@main.command(context_settings={"show_default": True})
@click.argument("shared", type=click.Path(exists=True, path_type=Path))
@click.argument("models", nargs=-1, required=True, type=click.Path(exists=True, path_type=Path))
@click.option(
    "--dataset", type=_PATH, required=True, help="What `full_dataset.py first32` of the shared folder writes."
)
@click.option("--out", type=_PATH, required=True, help="Folder of the records.")
def davis(shared: Path, models: tuple[Path, ...], dataset: Path, out: Path) -> None:
    """Refine tracks of real clips, in the frames that SHARED has at 854x480, by MODELS of the same at 256x256."""
    videos = dict(read_dataset(dataset))
    for path in model_files(models):
        name = path.stem
        folder = shared / "data/davis480p/frames" / name
        number = ReducedTracker(path, 1, 1).facts.num_frames
        files = open_frames(frame_files(folder)[:number])
        size = np.array([files.shape[2], files.shape[1]])
        true, hidden = videos[name].points[:, :number], videos[name].occluded[:, :number]
        row, frame = np.nonzero(~hidden & (np.arange(number) % STRIDE == 0))
        truth = true[row] * size - 0.5
        inside = np.clip(truth[np.arange(len(row)), frame], -0.5, size - 0.5)
        queries = np.column_stack([frame.astype(np.float64), inside])
        tracker = ReducedTracker(path, int(size[0]), int(size[1]))
        record, both = _compared(tracker, queries, np.arange(number), files, truth, hidden[row])
        counted = ~hidden[row] & (frame[:, None] != np.arange(number))
        raster = [np.linalg.norm((xy - truth) * RASTER / size, axis=-1)[counted] for xy in both]
        deltas = [100 * float(np.mean([(errors < limit).mean() for limit in THRESHOLDS])) for errors in raster]
        record |= {"delta_before": deltas[0], "delta": deltas[1]}
        write_record(out / f"{name}.json", {"clip": name, "model": _hash(path)} | record | provenance())
        click.echo(f"{name}: < delta_avg {deltas[0]:.2f} -> {deltas[1]:.2f}, {_told(record)}")


def _compared(
    tracker: AnyTracker,
    queries: npt.NDArray[np.float64],
    frames: npt.NDArray[np.int64],
    clip: Frames,
    truth: npt.NDArray[np.float64],
    occluded: npt.NDArray[np.bool_],
) -> tuple[Record, tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]]:
    """Errors in pixels before and after, and the places [N, M, 2]."""
    before = tracker.track(queries, frames)
    begin = time.process_time()
    after = refine(tracker, before, clip)
    seconds = time.process_time() - begin
    assert after.refined is not None
    counted = ~occluded & ~before.occluded & (queries[:, :1] != frames)
    errors_before, errors = (np.linalg.norm(tracks.xy - truth, axis=-1)[counted] for tracks in (before, after))
    record = {
        "point_frames": int(counted.sum()),
        "before": _percentiles(errors_before),
        "after": _percentiles(errors),
        "refined": float(after.refined[counted].mean()),
        "worse": float((errors > errors_before + 0.1).mean()),
        "point_frames_a_second": after.refined.size / seconds,
    }
    return record, (before.xy, after.xy)


def _percentiles(errors: npt.NDArray[np.floating]) -> dict[str, float]:
    return {str(share): float(np.percentile(errors, share)) for share in (50, 90, 99)}


def _told(record: Record) -> str:
    before, after = record["before"], record["after"]
    return (
        f"median {before['50']:.3f} -> {after['50']:.3f} px, 90th {before['90']:.2f} -> {after['90']:.2f} px, "
        f"{record['refined']:.1%} refined, {record['worse']:.2%} worse by more than 0.1 px, "
        f"{record['point_frames_a_second']:.0f} point-frames a CPU second"
    )


def _hash(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:12]


if __name__ == "__main__":
    main()

"""Answers of models to annotated points that are in sight, and how far off they are. Lengths are in units."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np
import numpy.typing as npt

from decomo_eval.dataset import Video
from decomo_eval.query_mode import STRIDED
from decomo_eval.tapvid import raster_to_pixels, sample_queries
from decomo_runtime import Tracker
from decomo_runtime.expected_error import Calibration
from decomotion.units import unit
from decomotion.windows import FILE_NAME
from harness.models import model_files

Floats = npt.NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class Answers:
    """Of one model, to points that are in sight."""

    clip: str
    frames: str
    """Their number and size."""
    median: float | None
    """That its held-out links are missed by."""
    score: Floats
    """[n], occlusion."""
    gap: npt.NDArray[np.int64]
    """[n], frames between query and answer, 1 or more."""
    error: Floats
    """[n], units."""
    refined_error: Floats
    """[n], of the same answers by `Tracker.refine`; NaN where it found nothing."""

    def told(self, calibration: Calibration) -> Floats:
        """[n], what it would say the error is."""
        return calibration.error(self.score, self.gap, self.median)


def ask(tracker: Tracker, videos: Sequence[Video]) -> Answers:
    """To all annotated points of `videos`, which are one clip with several annotations."""
    side = unit(tracker.height, tracker.width)
    parts: list[tuple[Floats, npt.NDArray[np.int64], Floats, Floats]] = []
    for video in videos:
        wanted = sample_queries(video, STRIDED)
        queries = wanted.in_pixels(tracker.width, tracker.height)
        tracks = tracker.track(queries)
        refined = tracker.refine(tracks, video.frames())
        truth = raster_to_pixels(wanted.tracks, tracker.width, tracker.height)
        gap = np.abs(tracks.frames - queries[:, :1].astype(np.int64))
        kept = ~wanted.occluded & (gap > 0)
        error, refined_error = (np.linalg.norm(each.xy - truth, axis=-1) / side for each in (tracks, refined))
        refined_error[~np.asarray(refined.refined)] = np.nan
        parts.append((tracks.occlusion[kept], gap[kept], error[kept], refined_error[kept]))
    score, gap, error, refined_error = (np.concatenate(each) for each in zip(*parts, strict=True))
    frames = f"{tracker.num_frames} of {tracker.width}x{tracker.height}"
    quality = tracker.quality
    median = None if quality is None else quality.all.median
    return Answers(tracker.clip_name, frames, median, score, gap, error, refined_error)


def asked(paths: Sequence[Path], datasets: Sequence[Mapping[str, Video]]) -> Iterator[Answers]:
    """Of all models that have annotations; says which have none."""
    for path in paths:
        tracker = Tracker(path, threads=1)
        videos = videos_of(tracker, datasets)
        if not videos:
            click.echo(f"left out: {path}, no annotations of {tracker.clip_name} with {tracker.num_frames} frames")
            continue
        answers = ask(tracker, videos)
        click.echo(f"{answers.clip}: {len(answers.error)} answers of {path}")
        yield answers


def videos_of(tracker: Tracker, datasets: Sequence[Mapping[str, Video]]) -> list[Video]:
    """The annotations of the clip that a model was fitted to: those of its name and number of frames."""
    named = [dataset[tracker.clip_name] for dataset in datasets if tracker.clip_name in dataset]
    return [video for video in named if video.num_frames == tracker.num_frames and not video.occluded.all()]


def model_paths(paths: Sequence[Path]) -> list[Path]:
    """Files, and folders of windows, among `paths` and within folders among them."""
    found: list[Path] = []
    for path in paths:
        layouts = sorted(path.rglob(FILE_NAME)) if path.is_dir() else []
        found += [layout.parent for layout in layouts if any(layout.parent.glob("*.onnx"))]
        files = [] if (path / FILE_NAME).is_file() else model_files([path])
        found += [file for file in files if not (file.parent / FILE_NAME).is_file()]
    return found

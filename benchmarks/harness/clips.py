"""Clips with ground truth: of a TAP-Vid pickle, or procedural ones drawn from seeds on the fly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np
import numpy.typing as npt

from decomo_eval.dataset import Video, read_dataset
from decomo_eval.errors import DatasetError
from decomo_eval.sample import generate
from decomotion.arrays import read_npz

PROCEDURAL = "procedural"
"""In the place of a dataset's path: clips of `decomo-sample`, named `seed<number>`."""
UNSEEN_SEEDS = (101, 102, 103, 104, 105)
"""The procedural clips where none are named. No knob has been tried on them."""
PROCEDURAL_FRAMES, PROCEDURAL_SIZE = 32, 256


@dataclass(frozen=True, eq=False)
class BenchmarkClip:
    """A video with true tracks and, where they are known, masks of what moves."""

    video: Video
    object_masks: npt.NDArray[np.bool_] | None
    """[T, H, W], True where a moving object is seen: for splitting scores, never for training."""


def read_clips(
    dataset: str, names: Sequence[str] | None = None, object_masks: Path | None = None
) -> dict[str, BenchmarkClip]:
    """The named clips of a dataset, or all, in the order of the names.

    Args:
        dataset: path of a TAP-Vid pickle, or `procedural`.
        names: clips; of the procedural ones `seed<number>`, default `UNSEEN_SEEDS`.
        object_masks: `.npz` with masks [T, H, W] by clip name; the procedural clips bring their own.

    Raises `click.UsageError` where a clip is unknown.
    """
    if dataset == PROCEDURAL:
        return {name: _procedural(name) for name in names or [f"seed{seed}" for seed in UNSEEN_SEEDS]}
    videos = read_dataset(dataset)
    chosen = names or list(videos)
    unknown = [name for name in chosen if name not in videos]
    if unknown:
        raise click.UsageError(f"{dataset} has no clip {', '.join(unknown)}; it has {', '.join(videos)}")
    masks = read_npz(object_masks, DatasetError, chosen) if object_masks is not None else {}
    return {name: BenchmarkClip(videos[name], masks.get(name)) for name in chosen}


def _procedural(name: str) -> BenchmarkClip:
    number = name.removeprefix("seed")
    if not number.isdecimal():
        raise click.UsageError(f"procedural clips are named seed<number>, for example seed101, not {name}")
    sample = generate(int(number), PROCEDURAL_FRAMES, PROCEDURAL_SIZE)
    height, width = sample.video.shape[1:3]
    video = Video(name, sample.video, height, width, sample.points.astype(np.float64), sample.occluded)
    return BenchmarkClip(video, sample.masks)

"""The stage `features`: descriptors at the points of every frame, reduced, float16."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from decomotion.clip import Clip
from decomotion.data.features.interface import FeatureExtractor
from decomotion.data.features.reduction import SAMPLE, Reduction, fit_reduction
from decomotion.data.sampling import sample_map
from decomotion.data.stages import write_array

REDUCTION = "reduction.npz"


def build_feature_arrays(
    clip: Clip,
    points: npt.NDArray[np.float32],
    extractor: FeatureExtractor | None,
    size: int,
    progress: bool,
    folder: Path,
) -> dict[str, Any]:
    """Fills the stage's folder with `feature.npy` at `points` [frame, point, 2], and with the reduction.

    Descriptors are read at the points frame by frame and kept as files until all are there: whole maps would fill
    the memory, and a killed run's are found again.
    """
    if extractor is None:
        np.save(folder / "feature.npy", np.zeros((*points.shape[:2], 0), np.float16))
        return {"channels": 0}
    read = folder / "described"
    read.mkdir(exist_ok=True)
    for frame in tqdm(range(len(clip)), "features", disable=not progress, leave=False):
        file = read / f"{frame}.npy"
        if not _readable(file):
            described = sample_map(extractor(clip.frames[frame]), points[frame], clip.height, clip.width)
            write_array(file, described.astype(np.float16))
    stride = max(1, len(clip) * points.shape[1] // SAMPLE)
    sample = np.concatenate([np.load(read / f"{frame}.npy")[::stride] for frame in range(len(clip))])
    reduction = fit_reduction(sample, size)
    channels = sample.shape[-1] if reduction.vectors is None else reduction.vectors.shape[1]
    shape = (*points.shape[:2], channels)
    feature = np.lib.format.open_memmap(folder / "feature.npy", mode="w+", dtype=np.float16, shape=shape)
    for frame in range(len(clip)):
        feature[frame] = reduction(np.load(read / f"{frame}.npy"))
    feature.flush()
    shutil.rmtree(read)
    vectors = np.zeros((channels, 0), np.float32) if reduction.vectors is None else reduction.vectors
    np.savez(folder / REDUCTION, mean=reduction.mean, vectors=vectors)
    return {"channels": channels}


def read_reduction(folder: Path) -> Reduction:
    """The reduction that a finished stage used."""
    with np.load(folder / REDUCTION) as content:
        vectors = content["vectors"]
        return Reduction(content["mean"], vectors if vectors.shape[1] else None)


def _readable(file: Path) -> bool:
    try:
        np.load(file, mmap_mode="r")
    except (OSError, ValueError):
        return False
    return True

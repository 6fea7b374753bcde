"""The stage `features`: descriptors at the points of every frame, reduced, float16."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from decomotion.arrays import allocated_memmap
from decomotion.clip import Clip
from decomotion.data.features.interface import FeatureExtractor
from decomotion.data.features.reduction import SAMPLE, Reduction, fit_reduction
from decomotion.data.sampling import sample_map
from decomotion.data.stages import readable, write_array, write_whole

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

    Descriptors are read at the points frame by frame and kept as files: whole maps would fill the memory, and a
    killed run's are found again. A frame's file goes as soon as it is reduced.
    """
    if extractor is None:
        np.save(folder / "feature.npy", np.zeros((*points.shape[:2], 0), np.float16))
        return {"channels": 0}
    read = folder / "described"
    if not (folder / REDUCTION).is_file():
        _describe(clip, points, extractor, progress, read)
        _fit(points, size, read, folder)
    reduction = read_reduction(folder)
    channels = len(reduction.mean) if reduction.vectors is None else reduction.vectors.shape[1]
    place = folder / "feature.npy"
    feature = allocated_memmap(place, np.float16, (*points.shape[:2], channels), keep=readable(place))
    for frame in range(len(clip)):
        file = read / f"{frame}.npy"
        if file.is_file():
            feature[frame] = reduction(np.load(file))
            feature.flush()
            file.unlink()
    shutil.rmtree(read)
    return {"channels": channels}


def _describe(
    clip: Clip, points: npt.NDArray[np.float32], extractor: FeatureExtractor, progress: bool, read: Path
) -> None:
    """Writes a file for each frame that has none: descriptors [point, channel], float16."""
    read.mkdir(exist_ok=True)
    for frame in tqdm(range(len(clip)), "features", disable=not progress, leave=False):
        file = read / f"{frame}.npy"
        if not readable(file):
            described = sample_map(extractor(clip.frames[frame]), points[frame], clip.height, clip.width)
            write_array(file, described.astype(np.float16))


def _fit(points: npt.NDArray[np.float32], size: int, read: Path, folder: Path) -> None:
    """Writes the reduction of what was read."""
    stride = max(1, points.shape[0] * points.shape[1] // SAMPLE)
    sample = np.concatenate([np.load(read / f"{frame}.npy")[::stride] for frame in range(len(points))])
    reduction = fit_reduction(sample, size)
    vectors = np.zeros((sample.shape[-1], 0), np.float32) if reduction.vectors is None else reduction.vectors

    def save(temporary: Path) -> None:
        with temporary.open("wb") as file:
            np.savez(file, mean=reduction.mean, vectors=vectors)

    write_whole(folder / REDUCTION, save)


def read_reduction(folder: Path) -> Reduction:
    """The reduction that a finished stage used."""
    with np.load(folder / REDUCTION) as content:
        vectors = content["vectors"]
        return Reduction(content["mean"], vectors if vectors.shape[1] else None)

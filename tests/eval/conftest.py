"""A small dataset in TAP-Vid's form, and perfect answers to it."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

FRAMES, HEIGHT, WIDTH, TRACKS = 11, 20, 32, 4


def make_entry(seed: int) -> dict[str, Any]:
    """A video of noise with four tracks, some of them occluded at times; each is visible in frame 0."""
    rng = np.random.default_rng(seed)
    start, step = rng.uniform(0.3, 0.7, (TRACKS, 1, 2)), rng.normal(0, 0.02, (TRACKS, FRAMES, 2))
    occluded = rng.random((TRACKS, FRAMES)) < 0.3
    occluded[:, :3] = False
    return {
        "video": rng.integers(0, 256, (FRAMES, HEIGHT, WIDTH, 3), dtype=np.uint8),
        "points": start + np.cumsum(step, axis=1),
        "occluded": occluded,
    }


@pytest.fixture
def entry() -> dict[str, Any]:
    return make_entry(0)


@pytest.fixture
def dataset_content() -> dict[str, dict[str, Any]]:
    """Two videos, `left` and `right`."""
    return {"left": make_entry(0), "right": make_entry(1)}


@pytest.fixture
def dataset(tmp_path: Path, dataset_content: dict[str, dict[str, Any]]) -> Path:
    path = tmp_path / "dataset.pkl"
    path.write_bytes(pickle.dumps(dataset_content))
    return path


@pytest.fixture
def write_predictions(tmp_path: Path, dataset: Path) -> Callable[..., Path]:
    """Writes the true tracks of the named videos as predictions, and returns their folder.

    Keyword arguments replace arrays of the file (None leaves one out).
    """

    def write(*names: str, query_mode: str = "strided", size: tuple[int, int] | None = None, **replaced: Any) -> Path:
        from decomo_eval.dataset import read_dataset
        from decomo_eval.tapvid import raster_to_pixels, sample_queries

        folder = tmp_path / "predictions"
        folder.mkdir(exist_ok=True)
        videos = read_dataset(dataset)
        for name in names:
            queries = sample_queries(videos[name], query_mode)
            width, height = size or (WIDTH, HEIGHT)
            arrays = {
                "queries": queries.in_pixels(width, height),
                "tracks": raster_to_pixels(queries.tracks, width, height).astype(np.float32),
                "occluded": queries.occluded,
            }
            if size is not None:
                arrays |= {"width": np.array(width), "height": np.array(height)}
            arrays = {key: value for key, value in (arrays | replaced).items() if value is not None}
            np.savez(folder / f"{name}.npz", **arrays)
        return folder

    return write

"""Tracks as numpy's arrays."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from decomo_runtime.errors import TracksFileError
from decomo_runtime.formats.about import About
from decomo_runtime.tracks import Tracks
from decomotion.arrays import read_npz


def write(tracks: Tracks, path: Path, about: About) -> None:
    """The arrays that docs/formats.md lists, compressed."""
    arrays: dict[str, Any] = {
        "queries": tracks.queries,
        "tracks": tracks.xy,
        "occluded": tracks.occluded,
        "occlusion": tracks.occlusion,
        "frames": tracks.frames,
        **({} if tracks.times is None else {"times": tracks.times}),
        **({} if tracks.refined is None else {"refined": tracks.refined}),
        **({} if tracks.error is None else {"error": tracks.error}),
    }
    if about.size is not None:
        arrays |= {"height": np.int64(about.height), "width": np.int64(about.width)}
    with open(path, "wb") as file:
        np.savez_compressed(file, **arrays)


def read(path: Path) -> tuple[Tracks, About]:
    """Raises `TracksFileError` where the file has no such arrays; without `frames` they count from 0."""
    arrays = read_npz(path, TracksFileError, remedy="write one with 'decomo-track'")
    missing = {"queries", "tracks", "occluded", "occlusion"} - arrays.keys()
    if missing:
        raise TracksFileError(f"{path} lacks the arrays {', '.join(sorted(missing))}; write it with 'decomo-track'")
    points, length = arrays["tracks"].shape[:2] if arrays["tracks"].ndim == 3 else (0, 0)
    arrays.setdefault("frames", np.arange(length))
    each = (points, length)
    shapes = {
        "tracks": (*each, 2),
        "occluded": each,
        "occlusion": each,
        "queries": (points, 3),
        "frames": (length,),
        **({"times": (length,)} if "times" in arrays else {}),
        **{key: each for key in ("refined", "error") if key in arrays},
    }
    for key, shape in shapes.items():
        if arrays[key].shape != shape or arrays[key].dtype.kind not in "biuf":
            raise TracksFileError(
                f"{path}: {key} must be numbers of the shape {list(shape)}, got {arrays[key].dtype} of "
                f"{list(arrays[key].shape)}; write it with 'decomo-track'"
            )
    frames = arrays["frames"].astype(np.float64)
    if not ((np.abs(frames) < 2**53) & (frames == np.floor(frames))).all():
        raise TracksFileError(f"{path}: frames must be whole numbers; write it with 'decomo-track'")
    told = [arrays[key] for key in ("height", "width") if key in arrays]
    if any(value.shape != () or value.dtype.kind not in "iu" or value < 1 for value in told) or len(told) == 1:
        raise TracksFileError(f"{path} must hold both height and width, as whole numbers from 1 on, or neither")
    with np.errstate(over="ignore"):  # places beyond float32 are infinitely far
        floats = {
            key: arrays[key].astype(np.float32) for key in ("tracks", "occlusion", "queries", "error") if key in arrays
        }
    tracks = Tracks(
        floats["tracks"],
        arrays["occluded"].astype(bool),
        floats["occlusion"],
        floats["queries"],
        arrays["frames"].astype(np.int64),
        (int(told[0]), int(told[1])) if told else None,
        arrays["times"].astype(np.float64) if "times" in arrays else None,
        arrays["refined"].astype(bool) if "refined" in arrays else None,
        floats.get("error"),
    )
    return tracks, About()

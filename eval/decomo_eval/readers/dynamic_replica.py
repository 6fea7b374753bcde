"""Dynamic Replica (Karaev et al., CVPR 2023): a split's folder.

    frame_annotations_<split>.jgz   gzipped JSON: a list of frames with sequence_name, camera_name ("left" or "right"),
                                    image {path} and trajectories {path}, relative to the split's folder
    trajectories of a frame         a dict of tensors saved by torch: traj_2d [N, 3], (x, y, depth) in pixels, x from 0
                                    to the width, and verts_inds_vis [N], whether each is visible

Points as in CoTracker's reader (`dr_dataset.py`): the left camera's first 300 frames; a point outside 0 to width - 1
and 0 to height - 1 is hidden; those visible in more than ten frames are kept. Of a sequence 256 are asked for, here
evenly spaced ones where theirs are drawn by chance, and each where it is first visible, where theirs are asked for in
frame 0 also if they are hidden there.
"""

from __future__ import annotations

import gzip
import json
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import numpy.typing as npt

from decomo_eval import figures
from decomo_eval.errors import DatasetError
from decomo_eval.readers.files import Videos, by_suffix, checked, evenly
from decomo_eval.safe_torch import load_tensors
from decomo_eval.video import FrameFolder, Video, made_video
from decomo_runtime.layouts import RASTER_SIZE

LAYOUT = "a folder of frame_annotations_<split>.jgz"
FRAMES, POINTS = 300, 256
"""Of a sequence."""
LEAST_VISIBLE = 10
"""A point is kept that is visible in more frames."""
_TRAJECTORIES, _VISIBLE = "traj_2d", "verts_inds_vis"


@dataclass(frozen=True)
class _Frame:
    """Files of a frame."""

    image: Path
    trajectories: Path


def holds(path: Path) -> bool:
    """Whether there are a split's annotations."""
    return bool(_files(path))


def read(path: Path) -> Mapping[str, Video]:
    """The sequences by name."""
    files = _files(path)
    if len(files) != 1:
        raise DatasetError(
            f"{path} must have one frame_annotations_<split>.jgz, not {len(files)}; give a split's folder"
        )
    return Videos(_sequences(path, files[0]), _read_sequence)


def _files(path: Path) -> list[Path]:
    return [file for file in by_suffix(path, ".jgz") if file.name.startswith("frame_annotations_")]


def _sequences(root: Path, file: Path) -> dict[str, list[_Frame]]:
    try:
        with gzip.open(file, "rt", encoding="utf-8") as text:
            entries = json.load(text)
    except (OSError, EOFError, zlib.error, ValueError, RecursionError) as error:
        raise DatasetError(f"{file} cannot be read as gzipped JSON ({error})") from error
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise DatasetError(f"{file} must be a list of frames")
    found: dict[str, list[_Frame]] = {}
    for entry in entries:
        if entry.get("camera_name") != "left":
            continue
        name = entry.get("sequence_name")
        if not isinstance(name, str):
            raise DatasetError(f"{file} must name the sequence of every frame")
        frames = found.setdefault(name, [])
        if len(frames) < FRAMES:
            frames.append(_Frame(_below(root, file, entry, "image"), _below(root, file, entry, "trajectories")))
    if not found:
        raise DatasetError(f"{file} has no frame of the left camera")
    return found


def _below(root: Path, file: Path, entry: Mapping[str, Any], key: str) -> Path:
    value = entry.get(key)
    path = value.get("path") if isinstance(value, dict) else None
    if (
        not isinstance(path, str)
        or "\0" in path
        or PurePosixPath(path).is_absolute()
        or ".." in PurePosixPath(path).parts
    ):
        raise DatasetError(f"{file} must have a path below its folder as {key} of every frame of the left camera")
    return root / path


def _read_sequence(name: str, files: Sequence[_Frame]) -> Video:
    frames = FrameFolder([frame.image for frame in files])
    width, height = size = frames.size
    xy, visible = _trajectories([frame.trajectories for frame in files])
    finite = np.asarray(np.isfinite(xy).all(axis=2))
    visible &= ((xy >= 0) & (xy <= [width - 1, height - 1])).all(axis=2)
    kept = np.count_nonzero(visible, axis=1) > LEAST_VISIBLE
    points, visible = np.where(finite[..., None], xy, 0)[kept] / size, visible[kept]

    def own(tracks: npt.NDArray[np.float64], _: npt.NDArray[np.bool_]) -> dict[str, float]:
        return figures.dynamic_replica(tracks, points * RASTER_SIZE, visible, size)

    return made_video(f"sequence {name} of {files[0].trajectories.parent}", name, frames, points, ~visible, figures=own)


def _trajectories(files: Sequence[Path]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
    """Of the points that are asked for, (x, y) [N, T, 2] and visible [N, T]."""
    xy, visible, number = [], [], 0
    for file in files:
        found = load_tensors(file, (_TRAJECTORIES, _VISIBLE))
        if len(found) != 2:
            raise DatasetError(f"{file} must have the tensors {_TRAJECTORIES} and {_VISIBLE}")
        trajectories = checked(str(file), _TRAJECTORIES, found[_TRAJECTORIES], 2)
        seen = checked(str(file), _VISIBLE, found[_VISIBLE], 1)
        number = number or len(trajectories)
        if trajectories.shape[1] < 2 or not number == len(trajectories) == len(seen):
            raise DatasetError(
                f"{file} must have {_TRAJECTORIES} [N, 3] and {_VISIBLE} [N], N = {number} as in the sequence's first "
                f"frame, not {list(trajectories.shape)} and {list(seen.shape)}"
            )
        chosen = evenly(number, POINTS)
        xy.append(trajectories[chosen, :2].astype(np.float64))
        visible.append(seen[chosen] != 0)
    return np.stack(xy, axis=1), np.stack(visible, axis=1)

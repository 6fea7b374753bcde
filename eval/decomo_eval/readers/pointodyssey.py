"""PointOdyssey (Zheng et al., ICCV 2023): a split's folder, of a folder for each scene.

    <scene>/rgbs/rgb_00000.jpg, ...
    <scene>/anno.npz        trajs_2d [T, N, 2] (x, y) in pixels, 0 to the width; visibs and valids [T, N]
    <scene>/annotations.npz in the first release: trajs_2d, and visibilities [T, N]: 0 hidden, 1 visible, 2 not valid

Points as in PIPs++'s reader for whole sequences (`pointodysseydataset_fullseq.py`): a position that is not finite, or
nearer than a pixel to the edge of the image, or outside, is not valid and not visible; points are left out that are not
valid and visible in frame 0 and in eight frames; of the others 256 evenly spaced ones are asked for.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

from decomo_eval import figures
from decomo_eval.errors import DatasetError
from decomo_eval.readers.files import Videos, arrays, by_scene, evenly, first_frames, frame_folder
from decomo_eval.video import Video, flags, made_video
from decomo_runtime.layouts import RASTER_SIZE
from decomotion.arrays import npz_keys

LAYOUT = "a folder of <scene>/anno.npz and <scene>/rgbs"
POINTS, FRAMES = 256, 8
"""Points of a scene, and frames in which each is seen at least."""
MARGIN = 32
"""Pixels outside the image to which positions are clipped."""

BoolArray = npt.NDArray[np.bool_]


def holds(path: Path) -> bool:
    """Whether a folder within has the annotations."""
    return bool(_files(path))


def read(path: Path) -> Mapping[str, Video]:
    """The scenes by their folders' names."""
    return Videos(_files(path), _read_scene)


def _files(path: Path) -> dict[str, Path]:
    return by_scene(path, "anno.npz", "annotations.npz")


def _read_scene(name: str, file: Path) -> Video:
    frames = frame_folder(file.parent / "rgbs")
    width, height = frames.size
    trajectories, visible, valid = _annotations(file, len(frames))
    x, y = trajectories[..., 0], trajectories[..., 1]
    inside = (x >= 1) & (x <= width - 2) & (y >= 1) & (y <= height - 2)  # nor is what is not finite
    valid, visible = valid & inside, visible & inside
    good = valid & visible
    (chosen,) = np.nonzero(good[0] & (np.count_nonzero(good, axis=0) >= FRAMES))
    chosen = chosen[evenly(len(chosen), POINTS)]
    xy, visible, valid = (array[:, chosen].swapaxes(0, 1) for array in (trajectories, visible, valid))
    xy = np.where(np.isfinite(xy).all(axis=2, keepdims=True), xy, 0).astype(np.float64)
    points = xy.clip(-MARGIN, [width + MARGIN, height + MARGIN]) / frames.size
    counted = partial(figures.pointodyssey, true=points * RASTER_SIZE, valid=valid)
    return made_video(f"scene {name} of {file}", name, frames, points, ~visible, figures=lambda xy, _: counted(xy))


def _annotations(file: Path, num_frames: int) -> tuple[npt.NDArray, BoolArray, BoolArray]:
    """Trajectories [T, N, 2], visible and valid [T, N]."""
    if "visibilities" in npz_keys(file, DatasetError):
        found = first_frames(str(file), arrays(file, trajs_2d=3, visibilities=2), num_frames)
        code = found["visibilities"]
        return _of_two(file, found["trajs_2d"]), code == 1, code < 2
    found = first_frames(str(file), arrays(file, trajs_2d=3, visibs=2, valids=2), num_frames)
    visible, valid = (flags(str(file), key, found[key]) for key in ("visibs", "valids"))
    return _of_two(file, found["trajs_2d"]), visible, valid


def _of_two(file: Path, trajectories: npt.NDArray) -> npt.NDArray:
    if trajectories.shape[2] != 2:
        raise DatasetError(f"{file} must have trajs_2d [T, N, 2], not {list(trajectories.shape)}")
    return trajectories

"""EgoPoints (Darkhalil et al., WACV 2025): a folder for each sequence.

    <sequence>/rgbs/*.jpg
    <sequence>/annot.npz    trajs_2d [T, N, 2] (x, y) in pixels, 0 to the width; [T, N] of 0 and 1: valids, where there
                            is a position; visibs, the visibility, and vis_valids, where there is one; out_of_view;
                            occluded, hidden within the image

Every point is asked for in frame 0, as in `egopoints_eval_cotracker.py`. TAP-Vid's metrics count where visibility is
known and, where the point is visible, its position.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np

from decomo_eval import figures
from decomo_eval.errors import DatasetError
from decomo_eval.readers.files import Videos, arrays, by_scene, first_frames, frame_folder
from decomo_eval.video import Video, flags, made_video
from decomo_runtime.layouts import RASTER_SIZE

LAYOUT = "a folder of <sequence>/annot.npz and <sequence>/rgbs"
_FLAGS = ("valids", "visibs", "vis_valids", "out_of_view", "occluded")


def holds(path: Path) -> bool:
    """Whether a folder within has the annotations."""
    return bool(by_scene(path, "annot.npz"))


def read(path: Path) -> Mapping[str, Video]:
    """The sequences by their folders' names."""
    return Videos(by_scene(path, "annot.npz"), _read_sequence)


def _read_sequence(name: str, file: Path) -> Video:
    frames = frame_folder(file.parent / "rgbs")
    found = first_frames(str(file), arrays(file, trajs_2d=3, **dict.fromkeys(_FLAGS, 2)), len(frames))
    if found["trajs_2d"].shape[2] != 2:
        raise DatasetError(f"{file} must have trajs_2d [T, N, 2], not {list(found['trajs_2d'].shape)}")
    valid, visible, judged, out_of_view, hidden = (flags(str(file), key, found[key]).T for key in _FLAGS)
    xy = found["trajs_2d"].astype(np.float64).swapaxes(0, 1)
    if not np.isfinite(xy[:, 0]).all():
        raise DatasetError(f"{file} must have a position in trajs_2d for every point in frame 0, where it is asked for")
    known = valid & np.isfinite(xy).all(axis=2)
    points = np.where(np.isfinite(xy), xy, 0) / frames.size
    counted = partial(
        figures.egopoints,
        true=points * RASTER_SIZE,
        valid=known,
        visible=visible,
        judged=judged,
        out_of_view=out_of_view,
        hidden=hidden,
    )
    seen = visible & judged & known
    seen[:, 0] = True
    return made_video(
        f"sequence {name} of {file}", name, frames, points, ~seen, judged=seen | (judged & ~visible), figures=counted
    )

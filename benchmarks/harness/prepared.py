"""What a fit learns from, asked itself: the links of a prepared clip as a tracker."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import numpy.typing as npt

from decomo_eval.dataset import Video, write_frames
from decomo_eval.predictions import Prediction
from decomo_eval.tapvid import Queries
from decomotion.clip import read_clip
from decomotion.data.config import DataConfig
from decomotion.data.links.filtering import follow
from decomotion.data.pool import Pool
from decomotion.data.prepare import prepare


def prepared_links(video: Video, config: DataConfig) -> Pool:
    """Those that a fit with seed 0 learns from; from the cache where it has prepared them."""
    with tempfile.TemporaryDirectory() as folder:
        return prepare(read_clip(write_frames(video, Path(folder) / video.name)), config, progress=False)


def follow_links(queries: Queries, pool: Pool, width: int, height: int) -> Prediction:
    """Where links lead from queries, in a clip of that size.

    A query goes where the pool's nearest point of its frame goes, shifted by as much as it lies beside that; where the
    link has no confidence it is hidden.
    """
    asked = queries.in_pixels(width, height)
    frames, xy = asked[:, 0].astype(int), asked[:, 1:]
    tracks = np.repeat(xy[:, None], pool.num_frames, axis=1)
    hidden: npt.NDArray[np.bool_] = np.zeros(tracks.shape[:2], bool)
    for frame in np.unique(frames).tolist():
        mine = np.flatnonzero(frames == frame)
        points = np.asarray(pool.points[frame])
        nearest = np.square(xy[mine, None] - points[None]).sum(axis=-1).argmin(axis=1)
        for target in (target for target in range(pool.num_frames) if target != frame):
            tracks[mine, target] = follow(xy[mine], points, pool.targets[frame, target], nearest)
            hidden[mine, target] = pool.confidence[frame, target][nearest] == 0
    return Prediction.from_pixels(tracks, hidden, width, height)

"""Films of scored videos: predicted tracks on the left, the true ones on the right."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt

from decomo_eval.scoring import Scored
from decomo_eval.tapvid import raster_to_pixels
from decomo_runtime import Tracks
from decomo_runtime.overlay import draw_tracks
from decomo_runtime.pictures import write_video

FPS = 24.0
"""Frames a second; TAP-Vid's files do not tell."""

NAMELESS = "video"
"""The file's name where the video's is empty."""

Image = npt.NDArray[np.uint8]


def write_film(scored: Scored, folder: str | Path, mark: str = "ring") -> Path:
    """Writes `<video>.mp4` in `folder` and returns its path; `mark`: of occluded points, as for an overlay."""
    path = Path(folder) / f"{scored.video.name.replace('/', '-') or NAMELESS}.mp4"
    write_video(path, side_by_side(scored, mark), FPS)
    return path


def side_by_side(scored: Scored, mark: str = "ring") -> Iterator[Image]:
    """Each frame twice, RGB: with the predicted and with the true tracks.

    Of a point that is asked for in several frames the first query is drawn. A true track ends where the point is
    hidden: TAP-Vid does not say where it is.
    """
    video, queries = scored.video, scored.queries
    truth = np.where(queries.occluded[..., None], np.nan, queries.tracks)
    _, first = np.unique(np.nan_to_num(truth, nan=-1), axis=0, return_index=True)
    rows = np.sort(first)
    asked, frames = queries.in_pixels(video.width, video.height)[rows], video.frames()

    def drawn(tracks: npt.NDArray[np.float64], occluded: npt.NDArray[np.bool_]) -> Iterator[Image]:
        xy = raster_to_pixels(tracks, video.width, video.height).astype(np.float32)
        known = Tracks(xy, occluded, occluded.astype(np.float32), asked, np.arange(video.num_frames))
        return draw_tracks(frames, known, mark=mark)

    said = drawn(scored.prediction.tracks[rows], scored.prediction.occluded[rows])
    true = drawn(truth[rows], queries.occluded[rows])
    for left, right in zip(said, true, strict=True):
        yield np.concatenate([left, right], axis=1)

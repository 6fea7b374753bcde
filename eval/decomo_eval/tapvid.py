"""TAP-Vid's queries and coordinates; the conversions themselves are those of `decomo_runtime.layouts`.

raster  TAP-Vid's own: the image spans 0..256 in x and in y whatever its size and shape; the top left pixel of a
        256x256 image has its centre at (0.5, 0.5). Queries are (t, y, x), tracks (x, y).
pixels  ours: pixels of an image of any width and height, centres at integers, so that the image spans
        -0.5..width - 0.5. Queries are (t, x, y), tracks (x, y).

x_raster = (x_pixels + 0.5) * 256 / width
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from decomo_eval.dataset import Video
from decomo_eval.query_mode import FIRST, check_query_mode
from decomo_runtime.layouts import RASTER_SIZE as RASTER_SIZE
from decomo_runtime.layouts import pixels_to_raster as pixels_to_raster
from decomo_runtime.layouts import raster_to_pixels

QUERY_STRIDE = 5
"""Frames between the query frames of the strided mode."""

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Queries:
    """The questions that a benchmark asks of one video and their true answers, in raster coordinates."""

    points: FloatArray
    """[N, 3], (t, y, x)."""
    tracks: FloatArray
    """[N, T, 2], (x, y) of the queried point in every frame."""
    occluded: npt.NDArray[np.bool_]
    """[N, T]."""
    judged: npt.NDArray[np.bool_] | None = None
    """[N, T]: where the truth is known; None: everywhere."""

    def chosen(self, rows: npt.NDArray[np.bool_]) -> Queries:
        """Some of them, by a mask [N]."""
        judged = None if self.judged is None else self.judged[rows]
        return Queries(self.points[rows], self.tracks[rows], self.occluded[rows], judged)

    def in_pixels(self, width: int, height: int) -> npt.NDArray[np.float32]:
        """The query points as float32 [N, 3], (t, x, y) in pixels of a video of that size."""
        xy = raster_to_pixels(self.points[:, :0:-1], width, height)
        return np.concatenate([self.points[:, :1], xy], axis=1).astype(np.float32)


def sample_queries(video: Video, query_mode: str) -> Queries:
    """The queries of a video, in the official order.

    `strided`: in frames 0, 5, 10, ... every track visible there, so that one track may be asked for several times.
    `first`: every track once, where it is first visible; tracks that are never visible are left out.
    """
    check_query_mode(query_mode)
    visible = ~video.occluded
    if query_mode == FIRST:
        (track,) = np.nonzero(visible.any(axis=1))
        frame = visible[track].argmax(axis=1)
    else:
        frame, track = np.nonzero(visible[:, ::QUERY_STRIDE].T)
        frame = frame * QUERY_STRIDE
    tracks = video.points * RASTER_SIZE
    x, y = tracks[track, frame].T
    judged = None if video.judged is None else video.judged[track]
    return Queries(np.stack([frame.astype(np.float64), y, x], axis=1), tracks[track], video.occluded[track], judged)

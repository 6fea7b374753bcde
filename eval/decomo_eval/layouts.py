"""What trackers' code returns, saved as it is: one `<video>.npz` in any of these layouts, recognised by its keys.

layout              keys and shapes                                                      from
ours                queries [N, 3] (t, x, y), tracks [N, T, 2], occluded [N, T]          `predictions.py`
CoTracker, Track-On, TAPNet, LocoTrack, TAPNext: `decomotion/tracker_files.py` has them  their own code
PIPs                trajs_e [T, N, 2], vis_e [T, N] probabilities or logits; queries     PIPs
                    [N, 3] (t, x, y) optional: PIPs keeps the query as the trajectory's own point

A leading axis of one video is dropped. Where these trackers' pixels begin differs between their scripts (`Convention`);
the queries, which the benchmark knows, tell which it is.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from decomo_eval.errors import PredictionError
from decomo_eval.tapvid import RASTER_SIZE, Queries
from decomotion import tracker_files
from decomotion.tracker_files import Arrays, asked_points, of_one_video, scores

Size = tuple[int, int]
"""(width, height) in pixels."""


class Convention(enum.Enum):
    """Where the image's left edge and right edge lie in pixel coordinates of a frame of width W; likewise in y."""

    CENTRES = (0.5, 0)
    """-0.5 and W - 0.5: pixel centres at integers, ours."""
    EDGES = (0.0, 0)
    """0 and W: TAP-Vid's own scripts, and so TAPNet's models."""
    CORNERS = (0.0, -1)
    """0 and W - 1: CoTracker's reader of TAP-Vid, which maps the fraction 1 to the last pixel's centre."""

    def to_raster(self, xy: npt.ArrayLike, size: Size) -> npt.NDArray[np.float64]:
        """[..., 2] (x, y) in pixels of a frame of `size` to TAP-Vid's raster."""
        shift, longer = self.value
        return (np.asarray(xy, dtype=np.float64) + shift) * (RASTER_SIZE / (np.array(size) + longer).clip(1))

    def from_raster(self, xy: npt.ArrayLike, size: Size) -> npt.NDArray[np.float64]:
        """The inverse of `to_raster`."""
        shift, longer = self.value
        return np.asarray(xy, dtype=np.float64) * ((np.array(size) + longer).clip(1) / RASTER_SIZE) - shift


@dataclass(frozen=True, eq=False)
class Answers:
    """A file's arrays, brought to our axes; their values are not checked yet."""

    queries: npt.NDArray[Any]
    """[N, 3], (t, x, y), in the file's pixels."""
    tracks: npt.NDArray[Any]
    """[N, T, 2], (x, y), in the file's pixels."""
    occluded: npt.NDArray[Any]
    """[N, T]."""
    conventions: tuple[Convention, ...] = tuple(Convention)
    """Those that the pixels may follow."""
    exact: bool = False
    """Whether the pixels are of the dataset's stored frames where the file does not name a size."""


def unpacked(path: Path, content: Arrays, queries: Queries) -> Answers:
    """Recognises the layout of a file's arrays and unpacks them.

    Args:
        path: of the file, for messages.
        content: its arrays by key.
        queries: the benchmark's, for a file without them.

    Raises `PredictionError` where a key is missing, or an array has not as many axes as its layout says.
    """
    if "trajs_e" in content:
        return _pips(path, content, queries)
    answered = tracker_files.unpacked(str(path), content, PredictionError)
    if answered is not None:
        return Answers(asked_points(str(path), content, PredictionError), *answered)
    for key in ("queries", "tracks", "occluded"):
        if key not in content:
            raise PredictionError(
                f"{path} lacks the key {key}; it must hold queries, tracks and occluded, or what another tracker "
                "returns (docs/scoring.md)"
            )
    return Answers(content["queries"], content["tracks"], content["occluded"], (Convention.CENTRES,), exact=True)


def _pips(path: Path, content: Arrays, queries: Queries) -> Answers:
    tracks = np.swapaxes(of_one_video(str(path), content, "trajs_e", 3, PredictionError), 0, 1)
    seen = scores(str(path), content, "vis_e", 2, PredictionError).T
    probabilities = seen.size == 0 or (seen.min() >= 0 and seen.max() <= 1)
    if "queries" in content:
        asked = of_one_video(str(path), content, "queries", 2, PredictionError)
    elif tracks.shape[:2] == queries.occluded.shape:
        frame = np.round(queries.points[:, 0]).astype(np.int64)
        asked = np.column_stack([frame, tracks[np.arange(len(frame)), frame]])
    else:
        raise PredictionError(
            f"{path} has trajs_e [T, N, 2] for {tracks.shape[1]} frames and {len(tracks)} points where the benchmark "
            f"has {queries.occluded.shape[1]} and {len(queries.points)}"
        )
    return Answers(asked, tracks, ~(seen > (0.5 if probabilities else 0)))

"""What trackers' code returns, saved as it is: one `<video>.npz` in any of these layouts, recognised by its keys.

layout      keys and shapes                                                              from
ours        queries [N, 3] (t, x, y), tracks [N, T, 2], occluded [N, T]                  `predictions.py`
CoTracker   queries [N, 3] (t, x, y), pred_tracks [T, N, 2], pred_visibility [T, N]      `CoTrackerPredictor`
TAPNet      query_points [N, 3] (t, y, x), tracks [N, T, 2] (x, y), and one of           TAPIR, BootsTAPIR
            visibles [N, T] | occlusion [N, T] with or without expected_dist [N, T], logits | occluded [N, T];
            pred_tracks and pred_occluded, as `compute_tapvid_metrics` takes them, in their places
PIPs        trajs_e [T, N, 2], vis_e [T, N] probabilities or logits; queries [N, 3]      PIPs
            (t, x, y) optional: PIPs keeps the query as the trajectory's own point

A leading axis of one video is dropped. Where these trackers' pixels begin differs between their scripts (`Convention`);
the queries, which the benchmark knows, tell which it is.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from decomo_eval.errors import PredictionError
from decomo_eval.tapvid import RASTER_SIZE, Queries
from decomo_runtime.layouts import COTRACKER_VISIBLE

Size = tuple[int, int]
"""(width, height) in pixels."""
Arrays = Mapping[str, npt.NDArray[Any]]


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
    if "pred_visibility" in content:
        return _cotracker(path, content)
    if "query_points" in content:
        return _tapnet(path, content)
    for key in ("queries", "tracks", "occluded"):
        if key not in content:
            raise PredictionError(
                f"{path} lacks the key {key}; it must hold queries, tracks and occluded, or what CoTracker, TAPNet or "
                "PIPs return (docs/formats.md)"
            )
    return Answers(content["queries"], content["tracks"], content["occluded"], (Convention.CENTRES,), exact=True)


def _cotracker(path: Path, content: Arrays) -> Answers:
    visibility = _scores(path, content, "pred_visibility", 2)
    return Answers(
        _of_one_video(path, content, "queries", 2),
        np.swapaxes(_of_one_video(path, content, "pred_tracks", 3), 0, 1),
        ~(visibility if visibility.dtype == bool else visibility > COTRACKER_VISIBLE).T,
    )


def _tapnet(path: Path, content: Arrays) -> Answers:
    points = _of_one_video(path, content, "query_points", 2)  # (t, y, x)
    tracks = _of_one_video(path, content, "pred_tracks" if "pred_tracks" in content else "tracks", 3)
    return Answers(np.concatenate([points[:, :1], points[:, :0:-1]], axis=1), tracks, _tapnet_occluded(path, content))


def _tapnet_occluded(path: Path, content: Arrays) -> npt.NDArray[Any]:
    """TAPIR's rule (Doersch et al. 2023): visible where (1 - occlusion) (1 - uncertainty) passes 0.5."""
    if "occlusion" in content:
        visible = 1 - _sigmoid(_scores(path, content, "occlusion", 2))
        if "expected_dist" in content:
            certain = 1 - _sigmoid(_scores(path, content, "expected_dist", 2))
            if certain.shape != visible.shape:
                raise PredictionError(
                    f"{path} has occlusion {list(visible.shape)} and expected_dist {list(certain.shape)}; both must be "
                    "[N, T]"
                )
            visible = visible * certain
        return ~(visible > 0.5)
    if "visibles" in content:
        visibles = _of_one_video(path, content, "visibles", 2)
        if visibles.dtype.kind not in "biuf" or not np.isin(visibles, (0, 1)).all():
            raise PredictionError(
                f"{path} must hold true or false as visibles; threshold them, or save TAPIR's logits as occlusion and "
                "expected_dist"
            )
        return visibles == 0
    return _of_one_video(path, content, "pred_occluded" if "pred_occluded" in content else "occluded", 2)


def _pips(path: Path, content: Arrays, queries: Queries) -> Answers:
    tracks = np.swapaxes(_of_one_video(path, content, "trajs_e", 3), 0, 1)
    scores = _scores(path, content, "vis_e", 2).T
    probabilities = scores.size == 0 or (scores.min() >= 0 and scores.max() <= 1)
    if "queries" in content:
        asked = _of_one_video(path, content, "queries", 2)
    elif tracks.shape[:2] == queries.occluded.shape:
        frame = np.round(queries.points[:, 0]).astype(np.int64)
        asked = np.column_stack([frame, tracks[np.arange(len(frame)), frame]])
    else:
        raise PredictionError(
            f"{path} has trajs_e [T, N, 2] for {tracks.shape[1]} frames and {len(tracks)} points where the benchmark "
            f"has {queries.occluded.shape[1]} and {len(queries.points)}"
        )
    return Answers(asked, tracks, ~(scores > (0.5 if probabilities else 0)))


def _of_one_video(path: Path, content: Arrays, key: str, axes: int) -> npt.NDArray[Any]:
    """An array of that many axes, a leading axis of one video dropped."""
    if key not in content:
        raise PredictionError(f"{path} lacks the key {key} of its layout; docs/formats.md has the layouts")
    array = content[key]
    if array.ndim == axes + 1 and len(array) == 1:
        array = array[0]
    if array.ndim != axes:
        raise PredictionError(f"{path} has {key} {list(content[key].shape)}; docs/formats.md has the shapes")
    return array


def _scores(path: Path, content: Arrays, key: str, axes: int) -> npt.NDArray[Any]:
    array = _of_one_video(path, content, key, axes)
    if array.dtype.kind not in "biuf" or not np.isfinite(array).all():
        raise PredictionError(f"{path} must hold finite numbers as {key}")
    return array


def _sigmoid(logits: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    return 0.5 * (1 + np.tanh(0.5 * logits.astype(np.float64)))

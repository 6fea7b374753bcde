"""A tracker's answers to a benchmark's queries: from a fitted model, or from a file that any tracker wrote.

`<video>.npz` holds, for the queries of one query mode in the official order (`tapvid.sample_queries`):
    queries     float [N, 3]     (t, x, y), for the check that these are the questions the benchmark asks
    tracks      float [N, T, 2]  (x, y) of each point in each frame, finite also where occluded
    occluded    bool  [N, T]     True = occluded
    width, height                optional: the size that the pixels of `queries` and `tracks` refer to;
                                 without them, that of the dataset's stored frames
    frames      int   [T]        optional: the frame of each column of `tracks`, which must be 0..T-1
Pixel centres lie at integers. Other keys, such as `occlusion`, are not read. `decomo-track` writes such a file.
What other trackers' code returns is taken as it is (`layouts.py`).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from decomo_eval.dataset import Video
from decomo_eval.errors import PredictionError
from decomo_eval.layouts import Convention, Size, unpacked
from decomo_eval.tapvid import RASTER_SIZE, Queries
from decomotion.arrays import read_npz

QUERY_TOLERANCE = 0.05
"""Raster pixels by which the x and y of a query may differ: above the rounding of float32 and of text files with two
decimals, and well under the half pixel of a wrong convention."""

_SQUARE = 1.05
"""Ratio of two sides, or of two such ratios, below which they count as equal."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """Where a tracker says the queried points are, in raster coordinates."""

    tracks: npt.NDArray[np.float64]
    """[N, T, 2], (x, y)."""
    occluded: npt.NDArray[np.bool_]
    """[N, T]."""
    size: Size
    """(width, height) of the frames that the tracker worked on: TAP-Vid scores 256x256 and full resolution apart."""

    @classmethod
    def from_pixels(cls, tracks: npt.ArrayLike, occluded: npt.ArrayLike, width: int, height: int) -> Prediction:
        """Answers in pixels of frames of that size, pixel centres at integers: tracks [N, T, 2], occluded [N, T]."""
        return cls(Convention.CENTRES.to_raster(tracks, (width, height)), np.asarray(occluded), (width, height))


def from_model(path: Path, video: Video, queries: Queries) -> Prediction:
    """Asks the fitted model at `path` (.onnx); it may have been fitted to frames of another size than the stored."""
    from decomo_runtime import Tracker

    tracker = Tracker(path)
    if tracker.num_frames != video.num_frames:
        raise PredictionError(
            f"{path} was fitted to {tracker.num_frames} frames but video {video.name} has {video.num_frames}; "
            "fit it to the dataset's own frames"
        )
    _check_upright(path, (tracker.width, tracker.height), video)
    asked = queries.in_pixels(tracker.width, tracker.height)
    edge = np.array([tracker.width, tracker.height], dtype=np.float32) - 0.5
    asked[:, 1:] = np.clip(asked[:, 1:], -0.5, edge)  # annotators may click a little outside; the model must not be
    answer = tracker.track(asked)
    size = tracker.width, tracker.height
    return _prediction(path, answer.xy, answer.occluded, size, Convention.CENTRES, queries)


def _check_upright(path: Path, size: Size, video: Video) -> None:
    """Raises `PredictionError` where frames of (width, height) `size` are the video's turned by a quarter."""
    aspect, turned = video.width / video.height, size[1] / size[0]
    if max(aspect, 1 / aspect) > _SQUARE and max(aspect / turned, turned / aspect) < _SQUARE:
        raise PredictionError(
            f"{path} is of frames of {size[0]}x{size[1]} but video {video.name} has {video.width}x{video.height}: one "
            "of the two is turned; fit it to the dataset's own frames, upright"
        )


def from_npz(path: Path, video: Video, queries: Queries) -> Prediction:
    """Reads the answers in `path` (.npz), in our layout or in that of another tracker."""
    content = read_npz(path, PredictionError)
    answers = unpacked(path, content, queries)
    if "frames" in content and not np.array_equal(content["frames"], np.arange(video.num_frames)):
        raise PredictionError(f"{path} must hold all {video.num_frames} frames of video {video.name}, in order")
    sizes = _sizes(path, content, (video.width, video.height), exact=answers.exact)
    _check_upright(path, sizes[0], video)
    readings = [(size, convention) for size in sizes for convention in answers.conventions]
    size, convention = _matching(path, answers.queries, queries, readings)
    return _prediction(path, answers.tracks, answers.occluded, size, convention, queries)


def _sizes(path: Path, content: dict[str, npt.NDArray[Any]], stored: Size, *, exact: bool) -> list[Size]:
    """What (width, height) the file's pixels may refer to, the likeliest first.

    The file's own, where it says so; else that of the stored frames and, unless `exact`, TAP-Vid's 256x256.
    """
    if "width" not in content and "height" not in content:
        return [stored] if exact else [stored, (RASTER_SIZE, RASTER_SIZE)]
    values = [content.get(key, np.array(0)) for key in ("width", "height")]
    if any(value.size != 1 or value.dtype.kind not in "iuf" or not 1 <= value.item() < np.inf for value in values):
        raise PredictionError(f"{path} must hold both width and height, as positive numbers, or neither")
    return [(int(values[0].item()), int(values[1].item()))]


def _matching(
    path: Path, answered: npt.NDArray[Any], queries: Queries, readings: list[tuple[Size, Convention]]
) -> tuple[Size, Convention]:
    """The first of `readings` under which `answered` [N, 3], (t, x, y), are the benchmark's queries in its order.

    Raises `PredictionError`, which names a query that differs under the first reading, where there is none.
    """
    if answered.shape != queries.points.shape:
        raise PredictionError(
            f"{path} answers queries {list(answered.shape)} but the benchmark asks {list(queries.points.shape)} in "
            "this query mode; were they sampled in the other mode?"
        )
    if answered.dtype.kind not in "iuf":
        raise PredictionError(f"{path} must hold numbers as queries, not {answered.dtype}")
    for size, convention in readings:
        if not _differing(answered, queries, size, convention).any():
            return size, convention
    size, convention = readings[0]
    row = int(_differing(answered, queries, size, convention).argmax())
    asked = _in_pixels(queries, size, convention)
    raise PredictionError(
        f"{path} has query {row} at (t, x, y) = {_point(answered[row])} but the benchmark's is at "
        f"{_point(asked[row])} in pixels of {size[0]}x{size[1]} frames; queries must be in the benchmark's order, "
        "and if the file's pixels are of another size it must say so by width and height"
    )


def _in_pixels(queries: Queries, size: Size, convention: Convention) -> npt.NDArray[np.float64]:
    """[N, 3], (t, x, y)."""
    return np.concatenate([queries.points[:, :1], convention.from_raster(queries.points[:, :0:-1], size)], axis=1)


def _differing(
    answered: npt.NDArray[Any], queries: Queries, size: Size, convention: Convention
) -> npt.NDArray[np.bool_]:
    """[N]: whether each answered query is another than the benchmark's."""
    apart = np.abs(convention.to_raster(answered[:, 1:], size) - queries.points[:, :0:-1]).max(axis=1)
    return ~((apart <= QUERY_TOLERANCE) & (answered[:, 0] == queries.points[:, 0]))


def _point(query: npt.NDArray[Any]) -> str:
    return "({:g}, {:.2f}, {:.2f})".format(*query)


def _prediction(
    path: Path,
    tracks: npt.NDArray[Any],
    occluded: npt.NDArray[Any],
    size: Size,
    convention: Convention,
    queries: Queries,
) -> Prediction:
    """Checks tracks in pixels of (width, height) `size` and brings them to the raster."""
    check_answers(str(path), tracks, occluded, queries)
    check_axes(str(path), tracks, _in_pixels(queries, size, convention))
    return Prediction(convention.to_raster(tracks, size), occluded.astype(bool), size)


def check_answers(source: str, tracks: npt.NDArray[Any], occluded: npt.NDArray[Any], queries: Queries) -> None:
    """Raises `PredictionError`, which names the `source`, where arrays are no finite answers to all queries."""
    expected = queries.occluded.shape
    if tracks.shape != (*expected, 2) or occluded.shape != expected:
        raise PredictionError(
            f"{source} has tracks {list(tracks.shape)} and occluded {list(occluded.shape)} where the benchmark needs "
            f"{[*expected, 2]} and {list(expected)}: query, frame, (x, y)"
        )
    if tracks.dtype.kind not in "iuf" or occluded.dtype.kind not in "biuf" or not np.isin(occluded, (0, 1)).all():
        raise PredictionError(f"{source} must hold numbers as tracks and true or false as occluded")
    lost = ~np.isfinite(tracks).all(axis=2)
    if lost.any():
        row, frame = np.argwhere(lost)[0]
        raise PredictionError(
            f"{source} has no finite position for query {row} in frame {frame}; give a best guess also where occluded"
        )


def check_axes(source: str, tracks: npt.NDArray[Any], asked: npt.NDArray[Any]) -> None:
    """Raises `PredictionError`, which names the `source`, where tracks are (y, x), or [T, N, 2] with N = T.

    No order is guessed: every layout has its own (`layouts.py`), and as many queries as frames hide that it is another.

    Args:
        source: of the tracks.
        tracks: [N, T, 2].
        asked: [N, 3], the queries (t, x, y) in the same pixels, near which (x, y) lie in the frames t.
    """
    if not len(asked):
        return
    row, frame = np.arange(len(asked)), asked[:, 0].astype(np.int64)
    answered = tracks[row, frame]
    if _misses(answered, asked) > 1 + 10 * _misses(answered[:, ::-1], asked):
        raise PredictionError(
            f"{source} has tracks that lie at their queries only with x and y exchanged; give them as (x, y)"
        )
    if tracks.shape[0] == tracks.shape[1] and _misses(answered, asked) > 1 + 10 * _misses(tracks[frame, row], asked):
        raise PredictionError(
            f"{source} has tracks that lie at their queries only with queries and frames exchanged, of which there are "
            f"{len(asked)} each; save tracks and what belongs to them with these axes the other way round"
        )


def _misses(xy: npt.NDArray[Any], asked: npt.NDArray[Any]) -> float:
    """Median distance of `xy` [N, 2] from the queries [N, 3], (t, x, y), along the farther axis."""
    return float(np.median(np.abs(xy - asked[:, 1:]).max(axis=1)))

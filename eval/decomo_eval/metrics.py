"""TAP-Vid's metrics and temporal coherence, equal to the official function's numbers. Numpy only, no files.

Axes: b video, n query, t frame. Positions are (x, y) pixels of TAP-Vid's 256x256 raster, in which the thresholds are.

A metric without anything to count (0/0) is nan, as in the official function, but without its warning: occlusion
accuracy where no frame counts, `pts_within_*` where no true point is visible in a frame that counts, `jaccard_*` where
besides nothing is predicted visible, temporal coherence where no true point is visible in three frames running.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from decomo_eval.errors import EvalError
from decomo_eval.query_mode import FIRST, check_query_mode

THRESHOLDS = (1, 2, 4, 8, 16)
"""Pixels; a point is within when its distance is strictly less."""

FloatArray = npt.NDArray[np.floating]
BoolArray = npt.NDArray[np.bool_]


def tapvid_metrics(
    query_points: npt.ArrayLike,
    gt_occluded: npt.ArrayLike,
    gt_tracks: npt.ArrayLike,
    pred_occluded: npt.ArrayLike,
    pred_tracks: npt.ArrayLike,
    query_mode: str,
    judged: npt.ArrayLike | None = None,
) -> dict[str, FloatArray]:
    """Occlusion accuracy, share of points within each threshold, and Jaccard: arrays [b], in 0..1, one value a video.

    Args:
        query_points: [b, n, 3], (t, y, x). Only t is read, rounded to the nearest frame.
        gt_occluded: bool [b, n, t], True where the true point is occluded.
        gt_tracks: [b, n, t, 2], (x, y). Where occluded, any value.
        pred_occluded: bool [b, n, t].
        pred_tracks: [b, n, t, 2], (x, y). A nan is a miss at every threshold.
        query_mode: `strided` counts all frames but the query's, `first` the frames after it.
        judged: bool [b, n, t], where the truth is known; elsewhere nothing counts. By default everywhere.

    Returns:
        occlusion_accuracy: share of the points whose predicted occlusion is right.
        pts_within_{1,2,4,8,16}: share of the truly visible points predicted within the threshold, whatever the
            predicted occlusion.
        jaccard_{1,2,4,8,16}: true positives / (true points + false positives). A true positive is visible, predicted
            visible and within the threshold; any other point predicted visible is a false positive.
        average_pts_within_thresh, average_jaccard: means over the thresholds.
    """
    check_query_mode(query_mode)
    gt_tracks, gt_occluded = _as_tracks("gt", gt_tracks, gt_occluded)
    pred_tracks, pred_occluded = _as_tracks("pred", pred_tracks, pred_occluded)
    _check_same_shape(gt_tracks, pred_tracks)
    counted = counted_frames(np.asarray(query_points), gt_occluded.shape, query_mode)
    if judged is not None:
        counted &= np.asarray(judged, dtype=bool)

    visible, pred_visible = ~gt_occluded, ~pred_occluded
    squared_distance = np.sum(np.square(pred_tracks - gt_tracks), axis=-1)
    true_points = _count(visible & counted)
    within = position_accuracy(gt_tracks, pred_tracks, visible & counted)

    metrics = {"occlusion_accuracy": ratio(_count((pred_occluded == gt_occluded) & counted), _count(counted))}
    for threshold in THRESHOLDS:
        correct = (squared_distance < threshold**2) & visible
        true_positives = _count(correct & pred_visible & counted)
        false_positives = _count(~correct & pred_visible & counted)
        metrics[f"pts_within_{threshold}"] = within[f"pts_within_{threshold}"]
        metrics[f"jaccard_{threshold}"] = ratio(true_positives, true_points + false_positives)
    metrics["average_jaccard"] = _mean_over_thresholds(metrics, "jaccard")
    metrics["average_pts_within_thresh"] = within["average_pts_within_thresh"]
    return metrics


def position_accuracy(
    gt_tracks: npt.ArrayLike, pred_tracks: npt.ArrayLike, where: npt.ArrayLike
) -> dict[str, FloatArray]:
    """Share of the points at `where` that are predicted within each threshold, whatever the predicted occlusion: [b].

    With `where` the visible points of the counted frames this is TAP-Vid's < delta; with `reappeared` it is the same
    of points that have come back.

    Args:
        gt_tracks: [b, n, t, 2], (x, y).
        pred_tracks: [b, n, t, 2]. A nan is a miss at every threshold.
        where: bool [b, n, t], the points to count; all of them visible.

    Returns: pts_within_{1,2,4,8,16} and their mean, average_pts_within_thresh.
    """
    where = np.asarray(where, dtype=bool)
    squared_distance = np.sum(np.square(np.asarray(pred_tracks) - np.asarray(gt_tracks)), axis=-1)
    shares = {
        f"pts_within_{threshold}": ratio(_count((squared_distance < threshold**2) & where), _count(where))
        for threshold in THRESHOLDS
    }
    return {**shares, "average_pts_within_thresh": _mean_over_thresholds(shares, "pts_within")}


def reappeared(
    query_points: npt.ArrayLike, gt_occluded: npt.ArrayLike, query_mode: str, judged: npt.ArrayLike | None = None
) -> BoolArray:
    """Which points are visible again after an occlusion: bool [b, n, t].

    True in the frames that `query_mode` counts in which the point is visible although it was occluded in at least one
    frame strictly between the query's frame and this one, in either direction of time: whoever starts from the query
    has to carry the point through what hid it. Of a query in frame 8 that is occluded in frames 3 and 4, the visible
    frames 0 to 2 are reappearances.

    Args:
        query_points: [b, n, 3], (t, y, x). Only t is read, rounded to the nearest frame.
        gt_occluded: bool [b, n, t].
        query_mode: as in `tapvid_metrics`.
        judged: as in `tapvid_metrics`; in other frames a point is not known to be hidden.
    """
    check_query_mode(query_mode)
    query_points, occluded = np.asarray(query_points), np.asarray(gt_occluded, dtype=bool)
    counted = counted_frames(query_points, occluded.shape, query_mode)
    at_query = np.round(query_points[..., :1]).astype(np.int64)
    hidden = occluded & (np.arange(occluded.shape[2]) != at_query)
    if judged is not None:
        hidden &= np.asarray(judged, dtype=bool)
    so_far = np.cumsum(hidden, axis=2)
    # of a visible frame and the query's, neither adds to the sum: the difference counts the frames between them
    between = np.abs(so_far - np.take_along_axis(so_far, at_query, axis=2))
    return counted & ~occluded & (between > 0)


def temporal_coherence(gt_occluded: npt.ArrayLike, gt_tracks: npt.ArrayLike, pred_tracks: npt.ArrayLike) -> FloatArray:
    """Mean L2 distance between the second differences of predicted and true track: [b], in pixels, 0 is best.

    The second difference in frame t is p[t+1] - 2 p[t] + p[t-1]; the mean runs over all triplets of successive frames
    of all queries in which the true point is visible in all three. Neither the query frame nor the predicted
    occlusion matters: the question is whether the motion is as smooth as the true one.

    Args:
        gt_occluded: bool [b, n, t].
        gt_tracks: [b, n, t, 2].
        pred_tracks: [b, n, t, 2].
    """
    gt_tracks, gt_occluded = _as_tracks("gt", gt_tracks, gt_occluded)
    pred_tracks = np.asarray(pred_tracks)
    _check_same_shape(gt_tracks, pred_tracks)
    error = np.subtract(pred_tracks, gt_tracks, dtype=np.float64)
    # The second difference is linear, so the difference of the two is that of the error.
    distance = np.linalg.norm(error[..., 2:, :] - 2 * error[..., 1:-1, :] + error[..., :-2, :], axis=-1)
    visible = ~gt_occluded
    counted = visible[..., 2:] & visible[..., 1:-1] & visible[..., :-2]
    return ratio(np.sum(distance, axis=(1, 2), where=counted), _count(counted))


def counted_frames(query_points: npt.NDArray, shape: tuple[int, ...], query_mode: str) -> BoolArray:
    """Which predictions count: bool [b, n, t]. Strided, all frames but the query's; first, the frames after it.

    Args:
        query_points: [b, n, 3], (t, y, x). Only t is read, rounded to the nearest frame.
        shape: (b, n, t).
        query_mode: `strided` or `first`.

    Raises `EvalError` where a query's frame is not one of the t, or a shape does not fit.
    """
    if query_points.shape != (*shape[:2], 3):
        raise EvalError(f"query_points must be [b, n, 3] with b, n = {shape[:2]}, but it is {list(query_points.shape)}")
    query_frames = np.round(query_points[..., :1]).astype(np.int64)
    frames = np.arange(shape[2])
    if np.any((query_frames < 0) | (query_frames >= len(frames))):
        raise EvalError(f"query frames must lie in 0..{len(frames) - 1}; query_points is (t, y, x), t first")
    return frames > query_frames if query_mode == FIRST else frames != query_frames


def _as_tracks(side: str, tracks: npt.ArrayLike, occluded: npt.ArrayLike) -> tuple[FloatArray, BoolArray]:
    tracks, occluded = np.asarray(tracks), np.asarray(occluded, dtype=bool)
    if tracks.ndim != 4 or tracks.shape != (*occluded.shape, 2):
        raise EvalError(
            f"{side}_tracks must be [b, n, t, 2] and {side}_occluded [b, n, t], "
            f"but they are {list(tracks.shape)} and {list(occluded.shape)}"
        )
    return tracks, occluded


def _check_same_shape(gt_tracks: npt.NDArray, pred_tracks: npt.NDArray) -> None:
    if gt_tracks.shape != pred_tracks.shape:
        raise EvalError(
            f"gt_tracks and pred_tracks must have one shape, but are {list(gt_tracks.shape)} "
            f"and {list(pred_tracks.shape)}"
        )


def _count(mask: BoolArray) -> npt.NDArray[np.int64]:
    return np.sum(mask, axis=(1, 2))


def ratio(numerator: npt.NDArray, denominator: npt.NDArray) -> FloatArray:
    """numerator / denominator, nan where the denominator is 0."""
    undefined = np.full(denominator.shape, np.nan)
    return np.divide(numerator, denominator, out=undefined, where=denominator > 0)


def mean_of_defined(values: FloatArray) -> FloatArray:
    """Mean of [b, n] over those of n that are not nan: [b]; nan where all are."""
    defined = ~np.isnan(values)
    return ratio(np.sum(values, axis=1, where=defined), np.sum(defined, axis=1))


def _mean_over_thresholds(metrics: dict[str, FloatArray], name: str) -> FloatArray:
    return np.mean(np.stack([metrics[f"{name}_{threshold}"] for threshold in THRESHOLDS], axis=1), axis=1)

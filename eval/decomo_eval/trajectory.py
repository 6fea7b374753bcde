"""Metrics of whole trajectories: survival and median trajectory error, of PointOdyssey (Zheng et al., ICCV 2023).

Axes and coordinates as in `metrics.py`: b video, n query, t frame; (x, y) pixels of TAP-Vid's 256x256 raster, in which
PointOdyssey's failure distance is given too. Predicted occlusion does not matter here.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from decomo_eval.metrics import FloatArray, counted_frames, mean_of_defined, ratio

FAILURE = 50
"""Pixels; a track fails where its prediction is farther than this from the visible true point."""


def survival(
    query_points: npt.ArrayLike,
    gt_occluded: npt.ArrayLike,
    gt_tracks: npt.ArrayLike,
    pred_tracks: npt.ArrayLike,
    query_mode: str,
) -> FloatArray:
    """Share of the counted frames that a track reaches before it fails, averaged over the queries: [b], 1 is best.

    Time runs outward from the query's frame, in both directions where the query mode counts both; a track that fails
    is lost from that frame on. Hidden points cannot fail. Queries without a counted frame are left out; nan where
    there are no others.

    PIPs++'s code counts the query's frame besides, in which nothing can fail: of tracks queried in frame 0 of T its
    figure is (1 + (T - 1) s) / T (`figures.pointodyssey` has it).

    Args:
        query_points: [b, n, 3], (t, y, x). Only t is read.
        gt_occluded: bool [b, n, t].
        gt_tracks: [b, n, t, 2].
        pred_tracks: [b, n, t, 2]. A nan is a failure.
        query_mode: `strided` or `first`.
    """
    query_points, occluded = np.asarray(query_points), np.asarray(gt_occluded, dtype=bool)
    counted = counted_frames(query_points, occluded.shape, query_mode)
    failed = counted & ~occluded & ~(_distance(gt_tracks, pred_tracks) <= FAILURE)
    at_query = np.round(query_points[..., :1]).astype(np.int64)
    so_far = np.cumsum(failed, axis=2)
    at_start = np.take_along_axis(so_far, at_query, axis=2)
    later = np.arange(occluded.shape[2]) >= at_query
    failures = np.where(later, so_far - at_start, at_start - so_far + failed)
    share = ratio(np.sum(counted & (failures == 0), axis=2), np.sum(counted, axis=2))
    return mean_of_defined(share)


def median_trajectory_error(
    query_points: npt.ArrayLike,
    gt_occluded: npt.ArrayLike,
    gt_tracks: npt.ArrayLike,
    pred_tracks: npt.ArrayLike,
    query_mode: str,
) -> FloatArray:
    """Median over time of each track's distance from the truth, averaged over the queries: [b], pixels, 0 is best.

    The median runs over the counted frames in which the true point is visible; queries without one are left out, nan
    where there are no others. Arguments as of `survival`; a nan in `pred_tracks` is infinitely far.
    """
    query_points, occluded = np.asarray(query_points), np.asarray(gt_occluded, dtype=bool)
    counted = counted_frames(query_points, occluded.shape, query_mode) & ~occluded
    distance = _distance(gt_tracks, pred_tracks)
    # what does not count is infinitely far and comes last; so does a nan, which counts
    ascending = np.sort(np.where(counted & ~np.isnan(distance), distance, np.inf), axis=2)
    number = np.sum(counted, axis=2, keepdims=True)
    middle = np.concatenate([(number - 1).clip(0) // 2, number // 2], axis=2)  # the same one where the number is odd
    medians = np.take_along_axis(ascending, middle.clip(max=max(occluded.shape[2] - 1, 0)), axis=2).mean(axis=2)
    medians[number[..., 0] == 0] = np.nan
    return mean_of_defined(medians)


def _distance(gt_tracks: npt.ArrayLike, pred_tracks: npt.ArrayLike) -> npt.NDArray[np.float64]:
    return np.linalg.norm(np.subtract(pred_tracks, gt_tracks, dtype=np.float64), axis=-1)

"""Scores by kind of point: static, moving, in sight all along, visible again after an occlusion, out of the frame."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from decomo_eval.errors import EvalError
from decomo_eval.measure import score
from decomo_eval.metrics import counted_frames, position_accuracy, ratio, reappeared
from decomo_eval.predictions import Prediction
from decomo_eval.redetection import redetection
from decomo_eval.tapvid import RASTER_SIZE, Queries

BoolArray = npt.NDArray[np.bool_]

COUNT = "count"
"""Beside the metrics of a split: how many queries (static, dynamic) or points (the others) it has."""


def score_splits(
    queries: Queries, prediction: Prediction, query_mode: str, object_masks: BoolArray | None = None
) -> dict[str, dict[str, float]]:
    """Metrics of parts of one video's points, each with its `count`; nan where there is nothing to count.

    static, dynamic: all metrics (`scoring.score`) of the queries off and on `object_masks`, judged in the query's own
        frame, where the point is visible. Only with `object_masks`; a split without queries is left out.
    visible, reappeared: position accuracy (`metrics.position_accuracy`) in the frames in which a point has been in
        sight ever since the query's, and in those in which it is visible again after an occlusion
        (`metrics.reappeared`); of the latter also AJ_RD (`redetection.redetection`).
    out_of_frame: occlusion accuracy where the true point is hidden because it lies outside the image. Only datasets
        that say where hidden points are, the rendered ones, have such; in others its count may be 0.

    Args:
        queries: of the video.
        prediction: the answers to them.
        query_mode: `strided` or `first`.
        object_masks: bool [T, H, W], True where a moving object is seen; of any size, over the whole image.
    """
    splits: dict[str, dict[str, float]] = {}
    if object_masks is not None:
        dynamic = on_objects(queries, object_masks)
        for name, rows in (("static", ~dynamic), ("dynamic", dynamic)):
            if rows.any():
                answers = Prediction(prediction.tracks[rows], prediction.occluded[rows], prediction.size)
                splits[name] = {COUNT: int(rows.sum()), **score(queries.chosen(rows), answers, query_mode)}
    points, occluded, tracks = queries.points[None], queries.occluded[None], queries.tracks[None]
    counted = counted_frames(points, occluded.shape, query_mode)
    judged = None if queries.judged is None else queries.judged[None]
    again = reappeared(points, occluded, query_mode, judged)
    for name, where in (("visible", counted & ~occluded & ~again), ("reappeared", again)):
        shares = position_accuracy(tracks, prediction.tracks[None], where)
        splits[name] = {COUNT: int(where.sum()), **_first_video(shares)}
    hidden = prediction.occluded[None]
    splits["reappeared"] |= _first_video(redetection(occluded, tracks, hidden, prediction.tracks[None], judged))
    if judged is not None:
        counted &= judged
    outside = counted & occluded & ((tracks < 0) | (tracks > RASTER_SIZE)).any(axis=-1)
    right = ratio((hidden & outside).sum(axis=(1, 2)), outside.sum(axis=(1, 2)))
    splits["out_of_frame"] = {COUNT: int(outside.sum()), **_first_video({"occlusion_accuracy": right})}
    return splits


def on_objects(queries: Queries, object_masks: BoolArray) -> BoolArray:
    """[N] bool: whether each query point lies on a masked pixel [T, H, W] of its frame.

    Raises `EvalError` where the masks are not of as many frames as the video.
    """
    if object_masks.ndim != 3 or len(object_masks) != queries.occluded.shape[1]:
        raise EvalError(
            f"object masks must be [T, H, W] with T = {queries.occluded.shape[1]} frames, but they are "
            f"{list(object_masks.shape)}"
        )
    size = np.array(object_masks.shape[1:])
    frame = np.round(queries.points[:, 0]).astype(np.int64)
    row, column = np.clip(np.floor(queries.points[:, 1:] * size / RASTER_SIZE).astype(np.int64), 0, size - 1).T
    return object_masks[frame, row, column]


def _first_video(metrics: Mapping[str, npt.NDArray[np.floating]]) -> dict[str, float]:
    return {name: float(value[0]) for name, value in metrics.items()}

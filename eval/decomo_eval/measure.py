"""All metrics of one video, pooled over its queries or query by query."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from decomo_eval import figures
from decomo_eval.metrics import FloatArray, tapvid_metrics, temporal_coherence
from decomo_eval.predictions import Prediction
from decomo_eval.tapvid import Queries
from decomo_eval.trajectory import median_trajectory_error, survival

TEMPORAL_COHERENCE = "temporal_coherence"
IN_PIXELS = (TEMPORAL_COHERENCE, "median_trajectory_error", *figures.IN_PIXELS)
"""Metrics in pixels at 256x256, less is better; the others are shares, 0..1."""

Batched = Callable[[npt.NDArray], npt.NDArray]


def told(name: str, value: float) -> str:
    """A metric's value as shown: percent, or pixels; a `-` where it is undefined."""
    if math.isnan(value):
        return "-"
    return f"{value:.2f} px" if name in IN_PIXELS else f"{100 * value:.1f}"


def score(queries: Queries, prediction: Prediction, query_mode: str) -> dict[str, float]:
    """Metrics of a video by their names, as TAP-Vid averages them over videos; nan where there is nothing to count."""
    metrics = _measured(queries, prediction, query_mode, lambda array: array[None])
    return {name: float(value[0]) for name, value in metrics.items()}


def score_tracks(queries: Queries, prediction: Prediction, query_mode: str) -> dict[str, FloatArray]:
    """Metrics of each query, [N]: those of as many videos of one query each (the official trackwise metrics)."""
    return _measured(queries, prediction, query_mode, lambda array: array[:, None])


def _measured(queries: Queries, prediction: Prediction, query_mode: str, batched: Batched) -> dict[str, FloatArray]:
    points, occluded, tracks = batched(queries.points), batched(queries.occluded), batched(queries.tracks)
    predicted, hidden = batched(prediction.tracks), batched(prediction.occluded)
    judged = None if queries.judged is None else batched(queries.judged)
    metrics = tapvid_metrics(points, occluded, tracks, hidden, predicted, query_mode, judged)
    metrics[TEMPORAL_COHERENCE] = temporal_coherence(occluded, tracks, predicted)
    metrics["survival"] = survival(points, occluded, tracks, predicted, query_mode)
    metrics["median_trajectory_error"] = median_trajectory_error(points, occluded, tracks, predicted, query_mode)
    return {name: np.asarray(value) for name, value in metrics.items()}

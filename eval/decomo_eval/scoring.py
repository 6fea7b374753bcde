"""From a dataset and a folder of models or predictions to a report: read, ask, measure, average."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from decomo_eval.dataset import Video, read_dataset
from decomo_eval.errors import DatasetError, EvalError, PredictionError
from decomo_eval.metrics import tapvid_metrics, temporal_coherence
from decomo_eval.predictions import Prediction, from_model, from_npz
from decomo_eval.query_mode import STRIDED, check_query_mode
from decomo_eval.tapvid import Queries, sample_queries

logger = logging.getLogger(__name__)

Predict = Callable[[Path, Video, Queries], Prediction]

TEMPORAL_COHERENCE = "temporal_coherence"


@dataclass(frozen=True)
class Report:
    """Scores of the videos for which there was something to score."""

    dataset: str
    """The dataset's path, as given."""
    query_mode: str
    videos: Mapping[str, Mapping[str, float]]
    """Metrics of each video by their official names, 0..1, and `temporal_coherence` in pixels at 256x256.

    A metric with nothing to count in a video is nan (`metrics.py`).
    """
    mean: Mapping[str, float]
    """Mean of each metric over the videos in which it is defined; nan where it is in none."""
    missing: tuple[str, ...]
    """Videos of the dataset without a file in the folder; not scored."""
    undefined: Mapping[str, tuple[str, ...]]
    """Which metrics are nan in which video, and so do not count in their mean."""

    def to_json(self) -> dict[str, Any]:
        """The report as plain JSON types; nan, which JSON does not have, becomes None."""
        return {
            "dataset": self.dataset,
            "query_mode": self.query_mode,
            "videos": {name: _without_nan(metrics) for name, metrics in self.videos.items()},
            "mean": _without_nan(self.mean),
            "missing": list(self.missing),
            "undefined": {name: list(metrics) for name, metrics in self.undefined.items()},
        }


def evaluate(
    dataset: str | Path,
    models: str | Path | None = None,
    predictions: str | Path | None = None,
    query_mode: str = STRIDED,
    videos: Sequence[str] | None = None,
) -> Report:
    """Scores a tracker on a TAP-Vid dataset.

    Args:
        dataset: TAP-Vid pickle.
        models: folder of `<video>.onnx`, asked through `decomo_runtime`; or
        predictions: folder of `<video>.npz` from any tracker (`predictions.py` has the keys).
        query_mode: `strided` or `first`.
        videos: names of the videos to score, each of which must have its file; by default all that have one.

    Raises `DatasetError` or `PredictionError` where a file is not as it should be.
    """
    check_query_mode(query_mode)
    folder, suffix, predict = _source(models, predictions)
    asked = _select(read_dataset(dataset), videos, dataset)
    files = {name: folder / f"{name}{suffix}" for name in asked}
    missing = tuple(name for name, file in files.items() if not file.is_file())
    if missing and (videos is not None or len(missing) == len(asked)):
        raise PredictionError(
            f"{folder} has no {', '.join(files[name].name for name in missing)}; it must hold <video>{suffix} for the "
            "videos to score"
        )

    scores = {}
    present = [name for name in asked if name not in missing]
    for number, name in enumerate(present, start=1):
        queries = sample_queries(asked[name], query_mode)
        scores[name] = score(queries, predict(files[name], asked[name], queries), query_mode)
        logger.info("scored %s (%d of %d), %d queries", name, number, len(present), len(queries.points))
    undefined = {
        name: tuple(metric for metric, value in metrics.items() if math.isnan(value))
        for name, metrics in scores.items()
    }
    return Report(
        dataset=str(dataset),
        query_mode=query_mode,
        videos=scores,
        mean=_mean_over_videos(scores),
        missing=missing,
        undefined={name: metrics for name, metrics in undefined.items() if metrics},
    )


def score(queries: Queries, prediction: Prediction, query_mode: str) -> dict[str, float]:
    """All metrics of one video."""
    true = queries.occluded[None], queries.tracks[None]
    predicted = prediction.occluded[None], prediction.tracks[None]
    metrics = tapvid_metrics(queries.points[None], *true, *predicted, query_mode)
    metrics[TEMPORAL_COHERENCE] = temporal_coherence(*true, prediction.tracks[None])
    return {name: float(value[0]) for name, value in metrics.items()}


def _source(models: str | Path | None, predictions: str | Path | None) -> tuple[Path, str, Predict]:
    """The folder, the suffix of its files, and how to get answers from one."""
    if models is not None and predictions is None:
        return Path(models), ".onnx", from_model
    if predictions is not None and models is None:
        return Path(predictions), ".npz", from_npz
    raise EvalError("give either models, a folder of <video>.onnx, or predictions, a folder of <video>.npz")


def _select(known: Mapping[str, Video], names: Sequence[str] | None, dataset: str | Path) -> dict[str, Video]:
    """The named videos in the order of the names, or all."""
    if names is None:
        return dict(known)
    unknown = [name for name in names if name not in known]
    if unknown:
        raise DatasetError(f"{dataset} has no video {', '.join(unknown)}; it has {', '.join(known)}")
    if not names:
        raise DatasetError(f"no video is named; {dataset} has {', '.join(known)}")
    return {name: known[name] for name in names}


def _mean_over_videos(scores: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """Mean of each metric over the videos in which it is defined."""
    names = next(iter(scores.values()))
    defined = {name: [m[name] for m in scores.values() if not math.isnan(m[name])] for name in names}
    return {name: math.fsum(values) / len(values) if values else math.nan for name, values in defined.items()}


def _without_nan(metrics: Mapping[str, float]) -> dict[str, float | None]:
    return {name: None if math.isnan(value) else value for name, value in metrics.items()}

"""From a dataset and a tracker's answers to a report: read, ask, measure, average. One video in memory at a time."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from decomo_eval.bootstrap import mean_interval
from decomo_eval.dataset import Video, chosen_reader, read_dataset
from decomo_eval.errors import DatasetError, EvalError, PredictionError
from decomo_eval.measure import score
from decomo_eval.names import ORIGINAL, STANDARD
from decomo_eval.predictions import Prediction, check_answers, check_axes, from_model, from_npz
from decomo_eval.query_mode import FIRST, check_query_mode
from decomo_eval.splits import COUNT, score_splits
from decomo_eval.tapvid import RASTER_SIZE, Queries, raster_to_pixels, sample_queries
from decomotion.arrays import npz_keys, read_npz
from decomotion.errors import InputError
from decomotion.windows import FILE_NAME as WINDOWS

logger = logging.getLogger(__name__)

Tracker = Callable[[Video, Queries], Prediction]

MODEL = ".onnx"

Metrics = Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Scored:
    """One video as it has just been scored, for those who look on."""

    video: Video
    queries: Queries
    prediction: Prediction
    metrics: Metrics
    """TAP-Vid's and those of trajectories; the benchmark's own figures are in the report."""


@dataclass(frozen=True)
class Report:
    """Scores of the videos for which there was something to score."""

    dataset: str
    """The dataset's path, as given."""
    query_mode: str
    tracker: str
    """Where the answers came from: the folder, or the tracker's name."""
    resolution: str
    """`256x256` or `original`: the frames that the tracker worked on. TAP-Vid keeps the two apart."""
    videos: Mapping[str, Metrics]
    """Metrics of each video by their official names, 0..1, and those of `measure.IN_PIXELS` in pixels at 256x256;
    in the query mode `first` also the benchmark's own (`figures.py`).

    A metric with nothing to count in a video is nan (`metrics.py`).
    """
    mean: Metrics
    """Mean of each metric over the videos in which it is defined; nan where it is in none."""
    interval: Mapping[str, tuple[float, float]]
    """95 % bootstrap interval of each mean, over videos (`bootstrap.py`); nan with fewer than two."""
    splits: Mapping[str, Metrics]
    """By kind of point (`splits.py`): the mean over videos of each metric, `count` being the sum."""
    missing: tuple[str, ...]
    """Videos of the dataset without a file in the folder; not scored."""
    undefined: Mapping[str, tuple[str, ...]]
    """Which metrics are nan in which video, and so do not count in their mean."""
    without_masks: tuple[str, ...] = ()
    """Videos scored that the object masks lack; in neither `static` nor `dynamic`."""
    figures: tuple[str, ...] = ()
    """Names of the metrics that are the benchmark's own."""

    def to_json(self) -> dict[str, Any]:
        """The report as plain JSON types; nan, which JSON does not have, becomes None."""
        return {
            "dataset": self.dataset,
            "query_mode": self.query_mode,
            "tracker": self.tracker,
            "resolution": self.resolution,
            "videos": {name: _without_nan(metrics) for name, metrics in self.videos.items()},
            "mean": _without_nan(self.mean),
            "interval": {
                name: [None if math.isnan(end) else end for end in ends] for name, ends in self.interval.items()
            },
            "splits": {name: _without_nan(metrics) for name, metrics in self.splits.items()},
            "missing": list(self.missing),
            "undefined": {name: list(metrics) for name, metrics in self.undefined.items()},
            "without_masks": list(self.without_masks),
            "figures": list(self.figures),
        }


def evaluate(
    dataset: str | Path,
    models: str | Path | None = None,
    predictions: str | Path | None = None,
    query_mode: str | None = None,
    videos: Sequence[str] | None = None,
    *,
    tracker: Tracker | None = None,
    resolution: str = ORIGINAL,
    object_masks: str | Path | None = None,
    watch: Callable[[Scored], object] | None = None,
    dataset_name: str | None = None,
    refused: Callable[[str, InputError | OSError], object] | None = None,
) -> Report:
    """Scores a tracker on a dataset; give one of `models`, `predictions` and `tracker`.

    Args:
        dataset: TAP-Vid pickle, or a dataset's folder (`dataset.read_dataset`).
        models: folder of `<video>.onnx`, or of folders `<video>` of windows, asked through `decomo_runtime`; or
        predictions: folder of `<video>.npz` from any tracker (`predictions.py`, `layouts.py`); or
        tracker: called as `tracker(video, queries)`, for instance `baselines.FlowBaseline("chain")`.
        resolution: of the videos that `tracker` is given (`dataset.read_dataset`); files say for themselves.
        query_mode: `strided` or `first`; by default the dataset's.
        videos: names of the videos to score, each of which must have its file; by default all that have one.
        object_masks: `.npz` of masks [T, H, W] by video, True where a moving object is seen: splits scores.
        watch: called with each video as soon as it is scored.
        dataset_name: the dataset's name (`readers.READERS`); by default its files tell.
        refused: called with the name of each video that cannot be scored, and why: it is left out, and is missing; and
            with that of each shard that cannot be read. Without this, the first one ends all.

    Raises `DatasetError` or `PredictionError` where a file is not as it should be.
    """
    query_mode = query_mode or chosen_reader(dataset, dataset_name).query_mode
    check_query_mode(query_mode)
    name_of_tracker, answers = _source(models, predictions, tracker)
    of_shard = None if refused is None else lambda shard, error: refused(shard.name, error)
    known = read_dataset(dataset, resolution, dataset_name, of_shard)
    asked = _select(known, videos, dataset)
    missing: tuple[str, ...] = ()
    if isinstance(answers, _Folder):
        missing = answers.missing(asked, all_needed=videos is not None)
    present = [name for name in asked if name not in missing]
    masks = None if object_masks is None else _Masks(Path(object_masks))
    without_masks = () if masks is None else masks.missing(present)

    scores: dict[str, Metrics] = {}
    splits: dict[str, Mapping[str, Metrics]] = {}
    resolutions: dict[str, str] = {}
    in_both, figures = False, {}
    for number, name in enumerate(present, start=1):
        try:
            video = known[name]
            queries = sample_queries(video, query_mode)
            prediction = answers(video, queries)
        except (InputError, OSError) as error:
            if refused is None:
                raise
            refused(name, error)
            missing += (name,)
            continue
        if len(queries.points):  # without any, a file does not tell what it was tracked at
            if category := _category(prediction, video):
                resolutions.setdefault(category, name)
                _check_one_category(resolutions)
            else:
                in_both = True
        metrics = score(queries, prediction, query_mode)
        own = video.figures if query_mode == FIRST else None
        figures = {} if own is None else own(prediction.tracks, prediction.occluded)
        scores[name] = {**metrics, **figures}
        objects = None if masks is None or name in without_masks else masks.of(name)
        splits[name] = score_splits(queries, prediction, query_mode, objects)
        if watch is not None:
            watch(Scored(video, queries, prediction, metrics))
        logger.info("scored %s (%d of %d), %d queries", name, number, len(present), len(queries.points))
    if not scores:
        raise PredictionError(f"no video of {dataset} can be scored; the first that was asked for is {present[0]}")
    undefined = {
        name: tuple(metric for metric, value in metrics.items() if math.isnan(value))
        for name, metrics in scores.items()
    }
    return Report(
        dataset=str(dataset),
        query_mode=query_mode,
        tracker=name_of_tracker,
        resolution=next(iter(resolutions), STANDARD if in_both else ORIGINAL),
        videos=scores,
        mean=_mean_over_videos(list(scores.values())),
        interval={name: mean_interval([m[name] for m in scores.values()]) for name in next(iter(scores.values()))},
        splits=_splits_over_videos(list(splits.values())),
        missing=missing,
        undefined={name: metrics for name, metrics in undefined.items() if metrics},
        without_masks=without_masks,
        figures=tuple(figures),
    )


@dataclass(frozen=True)
class _Folder:
    """Answers out of one file a video, or out of the folder `<video>` of a clip of several windows."""

    path: Path
    suffix: str
    read: Callable[[Path, Video, Queries], Prediction]

    def __call__(self, video: Video, queries: Queries) -> Prediction:
        return self.read(self._source(video.name), video, queries)

    def missing(self, names: Sequence[str], *, all_needed: bool) -> tuple[str, ...]:
        """The videos without a file; `PredictionError` where that is all of them, or any and `all_needed`."""
        absent = tuple(name for name in names if not self._source(name).exists())
        if absent and (all_needed or len(absent) == len(names)):
            raise PredictionError(
                f"{self.path} has no {_some([f'{name}{self.suffix}' for name in absent])}; it must hold "
                f"<video>{self.suffix} for the videos to score"
            )
        return absent

    def _source(self, name: str) -> Path:
        file = self.path / f"{name}{self.suffix}"
        windows = file.with_suffix("") / WINDOWS if self.suffix == MODEL else file
        return windows.parent if not file.is_file() and windows.is_file() else file


@dataclass(frozen=True)
class _Function:
    """Answers of a function, checked as those of files are."""

    name: str
    ask: Tracker

    def __call__(self, video: Video, queries: Queries) -> Prediction:
        answer, source = self.ask(video, queries), f"{self.name} on video {video.name}"
        check_answers(source, answer.tracks, answer.occluded, queries)
        check_axes(source, raster_to_pixels(answer.tracks, *answer.size), queries.in_pixels(*answer.size))
        return Prediction(answer.tracks, answer.occluded.astype(bool), answer.size)


def _source(
    models: str | Path | None, predictions: str | Path | None, tracker: Tracker | None
) -> tuple[str, _Function | _Folder]:
    """What to call the tracker, and whom to ask."""
    if [models, predictions, tracker].count(None) != 2:
        raise EvalError(
            "give either models, a folder of <video>.onnx, or predictions, a folder of <video>.npz, or a baseline"
        )
    if models is not None:
        return str(models), _Folder(Path(models), MODEL, from_model)
    if predictions is not None:
        return str(predictions), _Folder(Path(predictions), ".npz", from_npz)
    assert tracker is not None
    name = str(getattr(tracker, "name", getattr(tracker, "__name__", type(tracker).__name__)))
    return name, _Function(name, tracker)


@dataclass(frozen=True)
class _Masks:
    """Object masks of one file, read video by video."""

    path: Path

    def of(self, name: str) -> npt.NDArray[np.bool_]:
        """[T, H, W]; `DatasetError` where they are no masks."""
        mask = read_npz(self.path, DatasetError, (name,))[name]
        if mask.dtype.kind not in "biu":
            raise DatasetError(f"{self.path} must hold masks [T, H, W] of booleans or whole numbers, by video")
        return mask != 0

    def missing(self, names: Sequence[str]) -> tuple[str, ...]:
        """The videos without masks; `DatasetError` where that is all of them."""
        known = npz_keys(self.path, DatasetError)
        absent = tuple(name for name in names if name not in known)
        if len(absent) == len(names):
            raise DatasetError(f"{self.path} has masks of {_some(known)}, but of no video that is scored")
        return absent


def _category(prediction: Prediction, video: Video) -> str | None:
    """None where it is in both: stored at 256x256, and tracked so."""
    if prediction.size != (RASTER_SIZE, RASTER_SIZE):
        return ORIGINAL
    stored_so = (video.width, video.height) == prediction.size and not video.resized
    return None if stored_so else STANDARD


def _check_one_category(resolutions: Mapping[str, str]) -> None:
    if len(resolutions) > 1:
        raise PredictionError(
            f"{resolutions[STANDARD]} was tracked at 256x256 but {resolutions[ORIGINAL]} at another size; these are "
            "categories of their own: score them apart, with --videos or in folders of their own"
        )


def _select(known: Mapping[str, Video], names: Sequence[str] | None, dataset: str | Path) -> list[str]:
    """The names, checked and each once, or those of all videos."""
    if names is None:
        return list(known)
    unknown = [name for name in names if name not in known]
    if unknown:
        raise DatasetError(f"{dataset} has no video {_some(unknown)}; it has {_some(list(known))}")
    if not names:
        raise DatasetError(f"no video is named; {dataset} has {_some(list(known))}")
    return list(dict.fromkeys(names))


def _some(names: Sequence[str], most: int = 8) -> str:
    """For a sentence: a benchmark may have a thousand."""
    more = len(names) - most
    return ", ".join(names[:most]) + (f" and {more} more" if more > 0 else "")


def _mean_over_videos(scores: Sequence[Metrics]) -> dict[str, float]:
    """Mean of each metric over the videos in which it is defined."""
    names = dict.fromkeys(name for metrics in scores for name in metrics)
    defined = {name: [m[name] for m in scores if name in m and not math.isnan(m[name])] for name in names}
    return {name: math.fsum(values) / len(values) if values else math.nan for name, values in defined.items()}


def _splits_over_videos(splits: Sequence[Mapping[str, Metrics]]) -> dict[str, dict[str, float]]:
    """Mean over the videos that have a split; its counts are added."""
    over = {}
    for name in dict.fromkeys(name for video in splits for name in video):
        those = [video[name] for video in splits if name in video]
        over[name] = {**_mean_over_videos(those), COUNT: sum(metrics[COUNT] for metrics in those)}
    return over


def _without_nan(metrics: Mapping[str, float]) -> dict[str, float | None]:
    return {name: None if math.isnan(value) else value for name, value in metrics.items()}

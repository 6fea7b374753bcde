"""The report's plots, for its page and as files of their own: one way to make them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from decomo_eval.metrics import counted_frames
from decomo_eval.report.charts import check_drawing, error_over_time, threshold_curves, video_bars
from decomo_eval.scoring import Report, Scored
from decomotion.files import replacing

FloatArray = npt.NDArray[np.float64]


class Plots:
    """Looks on while videos are scored, for what their metrics do not hold: error by distance in time.

    Args:
        query_mode: of the evaluation, `strided` or `first`.

    Raises: `EvalError` where matplotlib is not installed.
    """

    def __init__(self, query_mode: str) -> None:
        check_drawing()
        self._query_mode = query_mode
        self._errors: list[FloatArray] = []

    def see(self, scored: Scored) -> None:
        """Takes a video that has been scored: for `evaluate(..., watch=plots.see)`."""
        self._errors.append(median_error_by_gap(scored, self._query_mode))

    def svg(self, report: Report) -> dict[str, str]:
        """Each plot by its name."""
        jaccards = {name: metrics["average_jaccard"] for name, metrics in report.videos.items()}
        return {
            "thresholds": threshold_curves(report.mean, "Share of points within a threshold, and Jaccard"),
            "videos": video_bars(jaccards, report.mean["average_jaccard"], "Average Jaccard by video"),
            "time": error_over_time(mean_over_videos(self._errors).tolist(), "Median error by frames from the query"),
        }

    def write(self, folder: str | Path, report: Report) -> list[Path]:
        """Writes `<name>.svg` for each plot in `folder`; returns the paths."""
        paths = []
        for name, svg in self.svg(report).items():
            paths.append(Path(folder) / f"{name}.svg")
            with replacing(paths[-1]) as temporary:
                temporary.write_text(svg, encoding="utf-8")
        return paths


def median_error_by_gap(scored: Scored, query_mode: str) -> FloatArray:
    """[T]: median distance from the truth, raster pixels, of visible points 0, 1, ... frames from their query.

    Both directions of time count where the query mode counts both; nan where there is nothing to count.
    """
    queries = scored.queries
    counted = counted_frames(queries.points[None], queries.occluded[None].shape, query_mode)[0] & ~queries.occluded
    error = np.linalg.norm(scored.prediction.tracks - queries.tracks, axis=-1)
    gap = np.abs(np.arange(error.shape[1]) - np.round(queries.points[:, :1]).astype(int))
    medians = np.full(error.shape[1], np.nan)
    order = np.argsort(gap[counted], kind="stable")
    gaps, begins = np.unique(gap[counted][order], return_index=True)
    for frames, errors in zip(gaps, np.split(error[counted][order], begins[1:]), strict=False):
        medians[frames] = np.median(errors)
    return medians


def mean_over_videos(errors: list[FloatArray]) -> FloatArray:
    """[T]: mean over the videos that have a value there; as long as the longest."""
    table = np.full((len(errors), max((len(each) for each in errors), default=0)), np.nan)
    for row, each in zip(table, errors, strict=True):
        row[: len(each)] = each
    defined = ~np.isnan(table)
    count = defined.sum(axis=0)
    return np.where(count > 0, np.where(defined, table, 0).sum(axis=0) / np.maximum(count, 1), np.nan)

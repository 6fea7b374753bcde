"""The report's numbers as CSV and LaTeX."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from decomo_eval.columns import COLUMNS
from decomo_eval.measure import score_tracks
from decomo_eval.scoring import Report, Scored

_LATEX_SPECIAL = re.compile(r"([&%$#_{}])")


def videos_csv(report: Report) -> str:
    """A line for each video, then `mean`, `low` and `high`: the interval's ends. Undefined values are empty."""
    ends = zip(*report.interval.values(), strict=True)
    low, high = (dict(zip(report.interval, values, strict=True)) for values in ends)
    rows = [*report.videos.items(), ("mean", report.mean), ("low", low), ("high", high)]
    written = io.StringIO()
    table = csv.writer(written, lineterminator="\n")
    table.writerow(["video", *report.mean])
    table.writerows([name, *_numbers(metrics[metric] for metric in report.mean)] for name, metrics in rows)
    return written.getvalue()


def track_rows(scored: Scored, query_mode: str) -> Iterator[Sequence[object]]:
    """A video's lines of `tracks.csv`: video, query, t, x, y of the query in raster pixels, then the metrics."""
    metrics = score_tracks(scored.queries, scored.prediction, query_mode)
    for query, (t, y, x) in enumerate(scored.queries.points.tolist()):
        numbers = _numbers(float(values[query]) for values in metrics.values())
        yield scored.video.name, query, round(t), f"{x:.3f}", f"{y:.3f}", *numbers


TRACK_KEYS = ("video", "query", "t", "x", "y")
"""Heading of the columns before the metrics."""


def latex_row(report: Report) -> str:
    """The mean as a row of the paper's table, under a comment that names the columns."""
    heading = " & ".join(["Method", *(column.latex for column in COLUMNS)])
    name = _LATEX_SPECIAL.sub(r"\\\1", Path(report.tracker).name)
    row = " & ".join([name, *(column.cell(report.mean) for column in COLUMNS)])
    return f"% {report.query_mode}, {len(report.videos)} videos: {heading}\n{row} \\\\\n"


def _numbers(values: Iterable[float]) -> list[str]:
    return ["" if math.isnan(value) else f"{value:.6g}" for value in values]

"""Writes a report's folder: `index.html`, `scores.json`, `videos.csv`, `tracks.csv` and `row.tex`."""

from __future__ import annotations

import base64
import csv
import json
import math
import time
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType

from decomo_eval.columns import COLUMNS
from decomo_eval.measure import told
from decomo_eval.report.clips import NEAR, WorstClips
from decomo_eval.report.plots import Plots
from decomo_eval.report.published import published
from decomo_eval.report.tables import TRACK_KEYS, latex_row, track_rows, videos_csv
from decomo_eval.scoring import Report, Scored
from decomotion import __version__
from decomotion.files import replacing


class ReportWriter:
    """Looks on while videos are scored, then writes; each file appears whole or not at all.

        with ReportWriter("report", "strided") as writer:
            writer.write(evaluate(..., query_mode="strided", watch=writer.see))

    Args:
        folder: made where it does not exist.
        query_mode: of the evaluation, `strided` or `first`.
    """

    def __init__(self, folder: str | Path, query_mode: str) -> None:
        self._folder, self._query_mode = Path(folder), query_mode
        self._worst, self._plots = WorstClips(), Plots(query_mode)
        self._open = ExitStack()

    def __enter__(self) -> ReportWriter:
        temporary = self._open.enter_context(replacing(self._folder / "tracks.csv"))
        file = self._open.enter_context(open(temporary, "w", encoding="utf-8", newline=""))
        self._tracks = csv.writer(file, lineterminator="\n")
        self._headed = False
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._open.__exit__(kind, error, trace)

    def see(self, scored: Scored) -> None:
        """Takes a video that has been scored: for `evaluate(..., watch=writer.see)`."""
        if not self._headed:
            self._tracks.writerow([*TRACK_KEYS, *scored.metrics])
            self._headed = True
        self._tracks.writerows(track_rows(scored, self._query_mode))
        self._worst.see(scored)
        self._plots.see(scored)

    def write(self, report: Report) -> Path:
        """Writes all but `tracks.csv`, which is whole when the writer is left; returns the page's path."""
        page = self._folder / "index.html"
        contents = {
            self._folder / "scores.json": json.dumps(report.to_json(), indent=2, allow_nan=False) + "\n",
            self._folder / "videos.csv": videos_csv(report),
            self._folder / "row.tex": latex_row(report),
            page: self._page(report),
        }
        for path, content in contents.items():
            with replacing(path) as temporary:
                temporary.write_text(content, encoding="utf-8")
        return page

    def _page(self, report: Report) -> str:
        from jinja2 import Environment, PackageLoader, StrictUndefined

        jinja = Environment(loader=PackageLoader("decomo_eval.report", "."), autoescape=True, undefined=StrictUndefined)
        return jinja.get_template("page.html.j2").render(
            report=report,
            columns=COLUMNS,
            plots=self._plots.svg(report),
            clips=self._worst.clips,
            data_uri=_data_uri,
            near=NEAR,
            published=published(report.query_mode),
            date=time.strftime("%Y-%m-%d"),
            version=__version__,
            share=lambda value: "-" if math.isnan(value) else f"{100 * value:.1f}",
            pixels=lambda value: "-" if math.isnan(value) else f"{value:.2f}",
            told=told,
            is_nan=math.isnan,
            nan=math.nan,
        )


def _data_uri(content: bytes | str, kind: str) -> str:
    """An image within the page."""
    encoded = content.encode("utf-8") if isinstance(content, str) else content
    return f"data:image/{kind};base64,{base64.b64encode(encoded).decode('ascii')}"

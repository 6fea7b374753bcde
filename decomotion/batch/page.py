"""The page of a batch: every clip with a picture, how good its fit is, and what failed. One file, no network."""

from __future__ import annotations

import base64
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined

from decomotion import __version__, quality
from decomotion.batch.task import PICTURE, TrackedTask
from decomotion.files import replacing
from decomotion.jobs.clip_task import is_model
from decomotion.jobs.folder import Results
from decomotion.jobs.task import Outcome
from decomotion.quality import Quality


@dataclass(frozen=True)
class Row:
    """A clip on the page."""

    name: str
    error: str | None
    minutes: float | None
    """Of its last attempt; None where none was made."""
    picture: str | None
    """A JPEG as a data URI."""
    quality: Quality | None
    """None where the run does not tell."""
    links: Mapping[str, str]
    """Paths from the page on, by what is there."""


def write_page(out: Path, results: Results) -> Path:
    """Writes `OUT/index.html`, and returns its path."""
    rows = [_row(out, outcome) for outcome in (*results.failed, *results.failed_before, *results.finished)]
    jinja = Environment(loader=PackageLoader("decomotion.batch", "."), autoescape=True, undefined=StrictUndefined)
    page = jinja.get_template("page.html.j2").render(
        name=out.absolute().name,
        failed=sorted((row for row in rows if row.error is not None), key=lambda row: row.name),
        finished=sorted((row for row in rows if row.error is None), key=lambda row: row.name),
        date=time.strftime("%Y-%m-%d"),
        version=__version__,
    )
    with replacing(out / "index.html") as temporary:
        temporary.write_text(page, encoding="utf-8")
    return out / "index.html"


def _row(out: Path, outcome: Outcome) -> Row:
    task = TrackedTask(outcome.name, out, "", (), 1)
    picture, log = task.folder / PICTURE, task.folder / "log.txt"
    files = {"overlay": task.drawn, "tracks": task.tracks, "model": task.model, "log": log}
    there = {name: file.relative_to(out).as_posix() for name, file in files.items() if file.is_file() or is_model(file)}
    uri = f"data:image/jpeg;base64,{base64.b64encode(picture.read_bytes()).decode()}" if picture.is_file() else None
    seconds = sum(outcome.seconds.values())
    return Row(
        outcome.name, outcome.error, seconds / 60 if seconds else None, uri, quality_of(task.folder / "run"), there
    )


def quality_of(run: Path) -> Quality | None:
    """How good a run's fit is; of several windows, the worst. None where it does not tell."""
    files = [run / quality.FILE_NAME, *sorted(run.glob(f"window-*/{quality.FILE_NAME}"))]
    return quality.worst(_parsed(file) for file in files)


def _parsed(file: Path) -> Quality | None:
    try:
        return quality.parse(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None

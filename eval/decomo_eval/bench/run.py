"""From a dataset to fitted models and their score: tasks, engine, one summary."""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from decomo_eval.bench.engine import Engine, LocalEngine, run_tasks
from decomo_eval.bench.task import Outcome, Task
from decomo_eval.dataset import read_dataset
from decomo_eval.errors import DatasetError, EvalError
from decomo_eval.query_mode import STRIDED
from decomo_eval.report.writer import ReportWriter
from decomo_eval.scoring import Report, evaluate
from decomotion.files import replacing

logger = logging.getLogger(__name__)

ESTIMATES = (30, 1000)
"""Numbers of videos for which the summary says how long they would take: TAP-Vid-DAVIS and TAP-Vid-Kinetics."""


@dataclass(frozen=True)
class Summary:
    """What came of a benchmark; `OUT/summary.json`."""

    finished: tuple[Outcome, ...]
    failed: tuple[Outcome, ...]
    jobs: int
    """Videos at a time."""
    report: Report | None
    """None where no video is finished."""

    @property
    def seconds_per_video(self) -> float | None:
        """Wall seconds of a finished task, on average, as one of `jobs` at a time."""
        seconds = [sum(outcome.seconds.values()) for outcome in self.finished if outcome.seconds]
        return sum(seconds) / len(seconds) if seconds else None

    @property
    def hours_for(self) -> dict[int, float] | None:
        """Wall hours of as many videos as `ESTIMATES` names, at that cost and with as many jobs."""
        each = self.seconds_per_video
        return None if each is None else {n: round(each * n / self.jobs / 3600, 2) for n in ESTIMATES}

    def to_json(self) -> dict[str, Any]:
        """As plain JSON types."""
        return {
            "finished": [asdict(outcome) for outcome in self.finished],
            "failed": [asdict(outcome) for outcome in self.failed],
            "jobs": self.jobs,
            "seconds_per_video": self.seconds_per_video,
            "hours_for": self.hours_for,
            "mean": None if self.report is None else self.report.to_json()["mean"],
        }


def bench(
    dataset: str | Path,
    out: str | Path,
    options: Sequence[str],
    *,
    engine: Engine | None = None,
    videos: Sequence[str] | None = None,
    attempts: int = 2,
    query_mode: str = STRIDED,
) -> Summary:
    """Fits, exports and scores every video; what is finished in `out` is not done again.

    Args:
        dataset: as of `evaluate`.
        out: folder of the models, the tasks, the report and the summary (`task.py`).
        options: decomo-train's, for every video.
        engine: where tasks run; by default here, one at a time.
        videos: names; by default all.
        attempts: how often a video is tried; then it is reported, and the others go on.
        query_mode: of the score.

    Raises `EvalError` where `out` was made from another dataset or with other options, or the engine does not run.
    """
    dataset, out = Path(dataset), Path(out)
    known = read_dataset(dataset)
    unknown = [name for name in videos or () if name not in known]
    if unknown:
        raise DatasetError(f"{dataset} has no video {', '.join(unknown)}")
    names = list(known if videos is None else videos)
    tasks = [Task(name, out.absolute(), tuple(options), attempts) for name in names]
    _claim(out, {"dataset": dataset.name, "options": list(options)})

    outcomes, begin = [], time.monotonic()
    with (engine or LocalEngine()).start() as room:
        for outcome in run_tasks(tasks, known, room):
            outcomes.append(outcome)
            _log(outcome, outcomes, len(tasks), time.monotonic() - begin)
    finished = tuple(outcome for outcome in outcomes if outcome.error is None)
    report = _score(dataset, out, [o.name for o in finished] if videos is not None else None, query_mode, finished)
    failed = tuple(outcome for outcome in outcomes if outcome.error is not None)
    summary = Summary(finished, failed, room.jobs, report)
    with replacing(out / "summary.json") as temporary:
        temporary.write_text(json.dumps(summary.to_json(), indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return summary


def _claim(out: Path, settings: Mapping[str, Any]) -> None:
    """Writes `bench.json`, or compares with it: a folder's models are of one dataset and one configuration."""
    file = out / "bench.json"
    if file.is_file():
        found = json.loads(file.read_text(encoding="utf-8"))
        different = [key for key, value in settings.items() if found.get(key) != value]
        if different:
            raise EvalError(f"{out} was made with another {' and '.join(different)}; give another --out")
        return
    with replacing(file) as temporary:
        temporary.write_text(json.dumps(settings, indent=2) + "\n", encoding="utf-8")


def _score(
    dataset: Path, out: Path, names: list[str] | None, query_mode: str, finished: Sequence[Outcome]
) -> Report | None:
    if not finished:
        return None
    with ReportWriter(out / "report", query_mode) as writer:
        report = evaluate(dataset, out / "models", None, query_mode, names, watch=writer.see)
        writer.write(report)
    return report


def _log(outcome: Outcome, outcomes: Sequence[Outcome], total: int, elapsed: float) -> None:
    tried = sum(each.attempts > 0 for each in outcomes)
    left = total - len(outcomes)
    estimate = f", about {elapsed / tried * left / 60:.0f} min left" if tried and left else ""
    how = "was there" if not outcome.attempts else "finished" if outcome.error is None else f"failed: {outcome.error}"
    logger.info("%s %s (%d of %d%s)", outcome.name, how, len(outcomes), total, estimate)

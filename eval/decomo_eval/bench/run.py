"""From a dataset to fitted models and their score: tasks, engine, one summary."""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from decomo_eval.bench.task import VideoTask
from decomo_eval.dataset import Video, read_dataset
from decomo_eval.errors import DatasetError, EvalError
from decomo_eval.names import ORIGINAL
from decomo_eval.query_mode import STRIDED
from decomo_eval.report.writer import ReportWriter
from decomo_eval.scoring import Report, evaluate
from decomotion.files import replacing
from decomotion.jobs.engine import Engine, LocalEngine, run_tasks
from decomotion.jobs.lock import alone
from decomotion.jobs.task import Outcome

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
    """None where no video is finished, or not scored."""

    @property
    def seconds_per_video(self) -> float | None:
        """Wall seconds of a finished task, on average, beside those that ran with it."""
        seconds = [sum(outcome.seconds.values()) for outcome in self.finished if outcome.seconds]
        return sum(seconds) / len(seconds) if seconds else None

    @property
    def hours_for(self) -> dict[int, float] | None:
        """Wall hours of as many videos as `ESTIMATES` names, as many at a time as when they were fitted."""
        each = [
            sum(outcome.seconds.values()) / (outcome.jobs or self.jobs) for outcome in self.finished if outcome.seconds
        ]
        return {n: round(sum(each) / len(each) * n / 3600, 2) for n in ESTIMATES} if each else None

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

    def write(self, out: Path) -> None:
        """Writes `summary.json`."""
        with replacing(out / "summary.json") as temporary:
            temporary.write_text(json.dumps(self.to_json(), indent=2, allow_nan=False) + "\n", encoding="utf-8")


def bench(
    dataset: str | Path,
    out: str | Path,
    options: Sequence[str],
    *,
    engine: Engine | None = None,
    videos: Sequence[str] | None = None,
    attempts: int = 2,
    query_mode: str = STRIDED,
    resolution: str = ORIGINAL,
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
        resolution: of the frames that are fitted (`dataset.read_dataset`).

    Raises `EvalError` where `out` was made from another dataset or with other options, or another run is at work on it;
    `EngineError` where the engine does not run.
    """
    dataset, out = Path(dataset), Path(out)
    known = read_dataset(dataset, resolution)
    unknown = [name for name in videos or () if name not in known]
    if unknown:
        raise DatasetError(f"{dataset} has no video {', '.join(unknown)}")
    names = list(known if videos is None else videos)
    tasks = [VideoTask(name, out.absolute(), tuple(options), attempts) for name in names]
    with alone(out, "decomo-bench", EvalError):
        _claim(out, {"dataset": dataset.name, "options": list(options), "resolution": resolution})
        outcomes, begin = [], time.monotonic()
        with (engine or LocalEngine()).start() as room:
            batch = _Batch(known)
            for outcome in run_tasks(tasks, room, batch.ready, batch.record):
                outcomes.append(outcome)
                _log(outcome, outcomes, len(tasks), time.monotonic() - begin)
        finished = tuple(outcome for outcome in outcomes if outcome.error is None)
        failed = tuple(outcome for outcome in outcomes if outcome.error is not None)
        summary = Summary(finished, failed, room.jobs, None)
        summary.write(out)  # should scoring fail, this is known
        summary = replace(summary, report=_score(dataset, out, query_mode, finished, failed))
        summary.write(out)
    return summary


class _Batch:
    """Makes tasks ready, and keeps how they went. Reads one video at a time."""

    def __init__(self, videos: Mapping[str, Video]) -> None:
        self._videos = videos
        self._clips: dict[str, str] = {}
        """Digests by video."""

    def ready(self, task: VideoTask) -> Outcome | None:
        """The outcome of a task that needs no attempt, or can have none; else its frames are written."""
        finished = task.finished_before()
        try:
            video = self._videos[task.name]
            clip = self._clips[task.name] = video.digest()
            if finished is None:
                task.prepare(video)
                return None
        except (DatasetError, OSError) as error:  # of one video: the others go on
            if finished is not None:
                return finished
            failed = Outcome(task.name, 1, {}, str(error))
            with suppress(OSError):
                task.record(failed)
            return failed
        if finished.clip in (None, clip):
            return finished
        why = f"{task.model} was fitted to other frames than the dataset's; move it away, or give another --out"
        return replace(finished, error=why)

    def record(self, task: VideoTask, outcome: Outcome) -> Outcome:
        """Writes `task.json`. A model that is there counts, also where the attempt was lost or given up for lost."""
        error = None if task.model.is_file() else outcome.error
        outcome = replace(outcome, clip=self._clips[task.name], error=error)
        task.record(outcome)
        return outcome


def _claim(out: Path, settings: Mapping[str, Any]) -> None:
    """Writes `bench.json`, or compares with it: a folder's models are of one dataset and one configuration."""
    file = out / "bench.json"
    if file.is_file() and any((out / "models").glob("*.onnx")):
        found = {"resolution": ORIGINAL, **json.loads(file.read_text(encoding="utf-8"))}
        different = [key for key, value in settings.items() if found.get(key) != value]
        if different:
            raise EvalError(f"{out} was made with another {' and '.join(different)}; give another --out")
        return
    with replacing(file) as temporary:
        temporary.write_text(json.dumps(settings, indent=2) + "\n", encoding="utf-8")


def _score(
    dataset: Path, out: Path, query_mode: str, finished: Sequence[Outcome], failed: Sequence[Outcome]
) -> Report | None:
    if not finished:
        return None
    names = [outcome.name for outcome in finished]
    with ReportWriter(out / "report", query_mode) as writer:
        report = evaluate(dataset, out / "models", None, query_mode, names, watch=writer.see)
        report = replace(report, missing=tuple(outcome.name for outcome in failed))
        writer.write(report)
    return report


def _log(outcome: Outcome, outcomes: Sequence[Outcome], total: int, elapsed: float) -> None:
    tried = sum(each.attempts > 0 for each in outcomes)
    left = total - len(outcomes)
    estimate = f", about {elapsed / tried * left / 60:.0f} min left" if tried and left else ""
    how = f"failed: {outcome.error}" if outcome.error else "finished" if outcome.attempts else "was there"
    logger.info("%s %s (%d of %d%s)", outcome.name, how, len(outcomes), total, estimate)

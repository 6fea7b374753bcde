"""A folder of many clips: what is in it is not done again, what fails costs one clip, and all is told at the end."""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Generic, TypeVar

from decomotion.cache import of_each
from decomotion.errors import InputError, TrainingError
from decomotion.files import replacing
from decomotion.jobs.clip_task import ClipTask, is_model, read_json
from decomotion.jobs.engine import Engine, run_tasks
from decomotion.jobs.task import Outcome

logger = logging.getLogger(__name__)

AnyClip = TypeVar("AnyClip", bound=ClipTask)


@dataclass(frozen=True)
class Results:
    """What came of the tasks."""

    finished: tuple[Outcome, ...]
    failed: tuple[Outcome, ...]
    jobs: int
    """Clips at a time."""
    failed_before: tuple[Outcome, ...] = ()
    """Clips that were not asked for, and failed in an earlier run."""

    def with_others(self, others: Iterable[Outcome | None]) -> Results:
        """With what is known of clips that were not asked for."""
        known = [outcome for outcome in others if outcome is not None]
        finished = tuple(outcome for outcome in known if outcome.error is None)
        failed = tuple(outcome for outcome in known if outcome.error is not None)
        return replace(self, finished=(*self.finished, *finished), failed_before=(*self.failed_before, *failed))

    @property
    def seconds_per_video(self) -> float | None:
        """Wall seconds of a finished task, on average, beside those that ran with it."""
        seconds = [sum(outcome.seconds.values()) for outcome in self.finished if outcome.seconds]
        return sum(seconds) / len(seconds) if seconds else None

    def hours(self, videos: int) -> float | None:
        """Wall hours of so many, as many at a time as ran when they were fitted."""
        each = [
            sum(outcome.seconds.values()) / (outcome.jobs or self.jobs) for outcome in self.finished if outcome.seconds
        ]
        return round(sum(each) / len(each) * videos / 3600, 2) if each else None

    def check_finished(self, what: str) -> None:
        """Raises `TrainingError` where some of the clips, called `what`, failed."""
        if self.failed:
            reasons = "; ".join(f"{outcome.name}: {outcome.error}" for outcome in self.failed)
            those = f"{len(self.failed)} of {len(self.failed) + len(self.finished)} {what}"
            raise TrainingError(f"{those} failed, the same command tries them again ({reasons})")

    def to_json(self) -> dict[str, Any]:
        """As plain JSON types."""
        return {
            "finished": [asdict(outcome) for outcome in self.finished],
            "failed": [asdict(outcome) for outcome in self.failed],
            "failed_before": [outcome.name for outcome in self.failed_before],
            "jobs": self.jobs,
            "seconds_per_video": self.seconds_per_video,
        }

    def write(self, out: Path) -> None:
        """Writes `summary.json`."""
        with replacing(out / "summary.json") as temporary:
            temporary.write_text(json.dumps(self.to_json(), indent=2, allow_nan=False) + "\n", encoding="utf-8")


@dataclass(frozen=True)
class ClipTasks(Generic[AnyClip]):
    """Tasks of one folder, and where their clips come from. What is wrong with one of these costs its task alone."""

    tasks: Sequence[AnyClip]
    digest: Callable[[AnyClip], str]
    """Of a task's clip. Raises `InputError` or `OSError`."""
    prepare: Callable[[AnyClip], object] = lambda _: None
    """Makes what an attempt needs. Raises likewise."""
    clear: Callable[[AnyClip], object] = lambda _: None
    """Does away with that, once the task is done."""

    def run(self, engine: Engine) -> Results:
        """Does what is not done. Raises `EngineError` where the engine does not run."""
        outcomes: list[Outcome] = []
        begin, count = time.monotonic(), len(self.tasks)
        tasks = [replace(task, prepared=of_each(task.prepared, count)) for task in self.tasks]
        with engine.start() as room:
            for outcome in run_tasks(tasks, room, self._ready, self._record):
                outcomes.append(outcome)
                _log(outcome, outcomes, count, time.monotonic() - begin)
            jobs = room.at_a_time
        finished = tuple(outcome for outcome in outcomes if outcome.error is None)
        failed = tuple(outcome for outcome in outcomes if outcome.error is not None)
        return Results(finished, failed, jobs)

    def before(self, task: AnyClip) -> Outcome | None:
        """How a task went before, where it is done; a failure where it is of or with something else."""
        if is_model(task.model):
            with suppress(InputError, OSError):  # what was made of a clip that is gone counts
                task = replace(task, clip=self.digest(task))
        return task.done_before()

    def _ready(self, task: AnyClip) -> AnyClip | Outcome:
        if outcome := self.before(task):
            return outcome
        try:
            task = replace(task, clip=self.digest(task))
            self.prepare(task)
        except (InputError, OSError) as error:
            failed = Outcome(task.name, 1, {}, str(error))
            with suppress(OSError):
                task.record(failed)
            return failed
        return task

    def _record(self, task: AnyClip, outcome: Outcome) -> Outcome:
        """What is there counts, also where the attempt was lost or given up for lost."""
        known = task.recorded()
        seconds = {**(known.seconds if known else {}), **outcome.seconds}
        error = None if task.is_done() else outcome.error
        outcome = replace(outcome, clip=task.clip, seconds=seconds, error=error)
        task.record(outcome)
        if outcome.error is None:
            self.clear(task)
        return outcome


def claim(file: Path, settings: Mapping[str, Any], error: type[InputError], **unsaid: Any) -> None:
    """Writes the settings with which a folder's models are made, or compares with them.

    A folder without a model takes others; a file that does not say a setting means the `unsaid` one. Raises `error`
    where they differ, or the file is damaged.
    """
    if file.is_file() and any((file.parent / "models").glob("*")):
        said = read_json(file)
        if not said:
            raise error(f"{file} is damaged and does not tell what the models there were made with; give another --out")
        found = {**unsaid, **said}
        different = [key for key, value in settings.items() if found.get(key) != value]
        if different:
            raise error(f"{file.parent} was made with another {' and '.join(different)}; give another --out")
        return
    with replacing(file) as temporary:
        temporary.write_text(json.dumps(settings, indent=2) + "\n", encoding="utf-8")


def _log(outcome: Outcome, outcomes: Sequence[Outcome], total: int, elapsed: float) -> None:
    tried = sum(each.attempts > 0 for each in outcomes)
    left = total - len(outcomes)
    estimate = f", about {elapsed / tried * left / 60:.0f} min left" if tried and left else ""
    logger.info("%s %s (%d of %d%s)", outcome.name, outcome.words, len(outcomes), total, estimate)

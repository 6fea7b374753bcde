"""From a dataset to fitted models and their score: tasks, engine, one summary.

OUT/bench.json                 what is fitted, and how: one answer for the whole folder
OUT/models/, OUT/videos/       as of all folders of many clips (`decomotion.jobs.clip_task`)
OUT/report/                    as of decomo-eval
OUT/summary.json               what came of it
"""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from decomo_eval.dataset import Video, chosen_reader, read_dataset, write_frames
from decomo_eval.errors import DatasetError, EvalError, PredictionError
from decomo_eval.names import ORIGINAL
from decomo_eval.readers import Reader
from decomo_eval.report.writer import ReportWriter
from decomo_eval.scoring import Report, evaluate
from decomotion.errors import InputError
from decomotion.jobs.clip_task import ClipTask
from decomotion.jobs.engine import Engine, LocalEngine
from decomotion.jobs.folder import ClipTasks, Results, claim
from decomotion.jobs.lock import alone
from decomotion.jobs.task import Outcome
from decomotion.presets import AUTO, AUTO_PRESET

ESTIMATES = (30, 1000)
"""Numbers of videos for which the summary says how long they would take: TAP-Vid-DAVIS and TAP-Vid-Kinetics."""
AS_ONE_SHOT = ("--shots", "ignore")
"""Options of decomo-train: benchmarks' videos are cut to shots."""


@dataclass(frozen=True)
class Summary(Results):
    """What came of a benchmark; `OUT/summary.json`."""

    report: Report | None = None
    """Of all finished videos in the folder; None where there is none, or they could not be scored."""

    @property
    def hours_for(self) -> dict[int, float] | None:
        """Wall hours of as many videos as `ESTIMATES` names, as many at a time as ran when they were fitted."""
        hours = {number: self.hours(number) for number in ESTIMATES}
        return {number: each for number, each in hours.items() if each is not None} or None

    def to_json(self) -> dict[str, Any]:
        """As plain JSON types."""
        return {
            **super().to_json(),
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
    query_mode: str | None = None,
    resolution: str = ORIGINAL,
    dataset_name: str | None = None,
    prepared: str = AUTO,
) -> Summary:
    """Fits, exports and scores every video; what is finished in `out` is not done again.

    Args:
        dataset: as of `evaluate`.
        out: folder of the models, the tasks, the report and the summary.
        options: decomo-train's, for every video.
        engine: where tasks run; by default here, one at a time.
        videos: names of those to fit; by default all. Summary and report are of all that is in `out`.
        attempts: how often a video is tried; then it is reported, and the others go on.
        query_mode: of the score; by default the dataset's.
        resolution: of the frames that are fitted (`dataset.read_dataset`).
        dataset_name: the dataset's name (`readers.READERS`); by default its files tell.
        prepared: what becomes of what a finished fit has prepared (`decomotion.cache.of_each`).

    A shard of the dataset that cannot be read is a failure; the videos of the others are fitted.

    Raises `EvalError` where `out` was made from another dataset or with other options, or another run is at work on it;
    `EngineError` where the engine does not run.
    """
    dataset, out = Path(dataset), Path(out)
    reader = chosen_reader(dataset, dataset_name)
    shards: list[Outcome] = []
    known = read_dataset(dataset, resolution, reader.name, lambda shard, error: shards.append(_unread(shard, error)))
    unknown = [name for name in videos or () if name not in known]
    if unknown:
        damaged = "".join(f"; {shard.error}" for shard in shards)
        raise DatasetError(f"{dataset} has no video {', '.join(unknown)}{damaged}")
    asked = set(known if videos is None else videos)
    tasks, unfit = _tasks(known, out, options, attempts, prepared)
    with alone(out, "decomo-bench", EvalError):
        settings = {"dataset": dataset.name, "reader": reader.name, "options": list(options), "resolution": resolution}
        claim(out / "bench.json", settings, EvalError, reader=reader.name, resolution=ORIGINAL)
        fitted = _fits(known, [task for task in tasks if task.name in asked])
        others = [task for task in tasks if task.name not in asked]
        results = fitted.run(engine or LocalEngine())
        failed = (*results.failed, *(each for each in unfit if each.name in asked), *(shards if videos is None else ()))
        results = replace(results, failed=failed)
        results = results.with_others(fitted.before(task) or task.recorded() for task in others)
        results = results.with_others(shards if videos is not None else ())
        summary = Summary(results.finished, results.failed, results.jobs, results.failed_before)
        summary.write(out)  # should scoring fail, this is known
        summary = _scored(summary, dataset, reader, out, query_mode or reader.query_mode)
        summary.write(out)
    return summary


def _tasks(
    names: Iterable[str], out: Path, options: Sequence[str], attempts: int, prepared: str = AUTO
) -> tuple[list[ClipTask], list[Outcome]]:
    """Of each video, whose frames are written beside the rest until it is done; and what became of those of no use."""
    tasks, unfit, out = [], [], out.absolute()
    for name in names:
        frames = out / "videos" / name / "frames" / name
        try:
            how = (*AS_ONE_SHOT, *options)
            tasks.append(ClipTask(name, out, str(frames), how, attempts, prepared=prepared))
        except InputError as error:
            unfit.append(Outcome(name, 1, {}, str(error)))
    return tasks, unfit


def _unread(shard: Path, error: DatasetError) -> Outcome:
    """Of the videos of a shard that cannot be read, whose names are not known."""
    return Outcome(shard.name, 1, {}, str(error))


def _fits(videos: Mapping[str, Video], tasks: Sequence[ClipTask]) -> ClipTasks[ClipTask]:
    """Tasks with their frames out of the dataset, of which one video is read at a time."""

    def digest(task: ClipTask) -> str:
        return videos[task.name].digest()

    def prepare(task: ClipTask) -> None:
        write_frames(videos[task.name], Path(task.source))

    def clear(task: ClipTask) -> None:
        shutil.rmtree(Path(task.source).parent, ignore_errors=True)

    return ClipTasks(tasks, digest, prepare, clear)


def _scored(summary: Summary, dataset: Path, reader: Reader, out: Path, query_mode: str) -> Summary:
    """With the report of what is finished; a model that cannot be scored is a failure of its own."""
    refused: dict[str, InputError | OSError] = {}
    names, report = [outcome.name for outcome in summary.finished], None
    if not names:
        return summary
    try:
        with ReportWriter(out / "report", query_mode) as writer:
            tell = {"watch": writer.see, "refused": refused.__setitem__}
            report = evaluate(dataset, out / "models", None, query_mode, names, dataset_name=reader.name, **tell)
            absent = (outcome.name for outcome in (*summary.failed, *summary.failed_before))
            report = replace(report, missing=(*report.missing, *absent))
            writer.write(report)
    except PredictionError:
        if not refused.keys() >= set(names):
            raise
    failed = tuple(
        replace(each, error=f"it cannot be scored ({refused[each.name]}); move its model away to fit it anew")
        for each in summary.finished
        if each.name in refused
    )
    finished = tuple(each for each in summary.finished if each.name not in refused)
    return replace(summary, finished=finished, failed=(*summary.failed, *failed), report=report)


def command_options(
    preset: str, time_budget: str | None, steps: int | None, seed: int, overrides: Sequence[str]
) -> tuple[str, ...]:
    """decomo-train's options of every task.

    Raises `ConfigError` where it would refuse them.
    """
    from decomotion.config import load

    load(AUTO_PRESET if preset == AUTO else preset, overrides=tuple(overrides))
    budget = [*(["--time-budget", time_budget] if time_budget else []), *(["--steps", str(steps)] if steps else [])]
    settings = [part for override in overrides for part in ("--set", override)]
    return ("--preset", preset, "--seed", str(seed), *budget, *settings)

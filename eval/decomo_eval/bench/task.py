"""One video of a benchmark: from its frames to `models/<video>.onnx`. Done once, however often it is asked for.

OUT/bench.json                 what is fitted, and how: one answer for the whole folder
OUT/models/<video>.onnx        appears when the task is finished, and only then
OUT/videos/<video>/task.json   how it went: attempts, seconds of each stage, the error of the last attempt
OUT/videos/<video>/log.txt     what the commands printed in the last attempt
OUT/videos/<video>/run/        the run, as decomo-train leaves it

An attempt works in a folder of its own, `.attempt-*`, and what it makes is moved to its place at the end: one that was
given up for lost, but still runs somewhere, spoils nothing.
"""

from __future__ import annotations

import json
import platform
import shutil
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import MappingProxyType

from decomo_eval.dataset import Video, write_frames
from decomo_eval.errors import DatasetError
from decomotion.files import replacing
from decomotion.jobs.task import Outcome, run_stages
from decomotion.presets import AUTO, AUTO_PRESET

COMMANDS: Mapping[str, tuple[str, ...]] = {"train": ("-m", "decomotion.cli"), "export": ("-m", "decomo_export.cli")}
"""Arguments of python, by stage. A stage is a process of its own: what kills one leaves the others alone."""


@dataclass(frozen=True)
class VideoTask:
    """A video to be fitted."""

    name: str
    """Of the video."""
    out: Path
    """The benchmark's folder, in full: attempts run in other folders and, on a cluster, on other machines."""
    options: tuple[str, ...]
    """Of decomo-train."""
    attempts: int
    """How often it is tried."""
    commands: Mapping[str, tuple[str, ...]] = field(default_factory=lambda: COMMANDS)

    def __post_init__(self) -> None:
        if not self.name or Path(self.name).name != self.name or self.name.startswith("."):
            raise DatasetError(f"the video {self.name!r} has a name that cannot be a file's; rename it in the dataset")

    @property
    def model(self) -> Path:
        """Where the model goes."""
        return self.out / "models" / f"{self.name}.onnx"

    @property
    def folder(self) -> Path:
        """All else."""
        return self.out / "videos" / self.name

    @property
    def frames(self) -> Path:
        """The clip, until the model is there."""
        return self.folder / "frames" / self.name

    def prepare(self, video: Video) -> None:
        """Writes what an attempt reads. Raises `DatasetError` where a frame does not decode."""
        write_frames(video, self.frames)

    def attempt(self, number: int, threads: int, variables: Mapping[str, str] = MappingProxyType({})) -> Outcome:
        """Fits and exports the video: see `decomotion.jobs.task.Task`."""
        if not self.frames.is_dir():
            where = f"{self.frames} is not there on {platform.node()}"
            return Outcome(self.name, number, {}, f"{where}; --out has to be a folder that all machines share")
        for left in self.folder.glob(".attempt-*"):  # what the last attempt prepared is in the cache
            shutil.rmtree(left, ignore_errors=True)
        here = self.folder / f".attempt-{uuid.uuid4().hex[:8]}"
        here.mkdir()
        run, model = here / "run", here / f"{self.name}.onnx"
        arguments = {
            "train": (str(self.frames), "--out", str(run), "--shots", "ignore", *self.options),
            "export": (str(model), "--run", str(run)),
        }
        stages = [(stage, [*command, *arguments[stage]]) for stage, command in self.commands.items()]
        seconds, error = run_stages(stages, self.folder / "log.txt", threads, variables)
        if error is None:
            self._keep(run, model)
        return Outcome(self.name, number, seconds, error)

    def record(self, outcome: Outcome) -> None:
        """Writes `task.json`."""
        with replacing(self.folder / "task.json") as temporary:
            temporary.write_text(json.dumps(asdict(outcome), indent=2) + "\n", encoding="utf-8")

    def finished_before(self) -> Outcome | None:
        """How it went in an earlier run, where the model is there."""
        if not self.model.is_file():
            return None
        report = self.folder / "task.json"
        known = json.loads(report.read_text(encoding="utf-8")) if report.is_file() else {}
        return Outcome(self.name, 0, known.get("seconds", {}), None, known.get("jobs"), known.get("clip"))

    def _keep(self, run: Path, model: Path) -> None:
        shutil.rmtree(self.folder / "run", ignore_errors=True)
        run.replace(self.folder / "run")
        self.model.parent.mkdir(parents=True, exist_ok=True)
        model.replace(self.model)
        for left in (model.parent, self.frames.parent):
            shutil.rmtree(left, ignore_errors=True)


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

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
import os
import platform
import shutil
import subprocess
import sys
import time
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import MappingProxyType

from decomo_eval.dataset import Video, write_frames
from decomo_eval.errors import DatasetError
from decomotion.files import replacing
from decomotion.presets import AUTO, AUTO_PRESET

COMMANDS: Mapping[str, tuple[str, ...]] = {"train": ("-m", "decomotion.cli"), "export": ("-m", "decomo_export.cli")}
"""Arguments of python, by stage. A stage is a process of its own: what kills one leaves the others alone."""


@dataclass(frozen=True)
class Outcome:
    """How a task went."""

    name: str
    attempts: int
    """0: it was finished before."""
    seconds: dict[str, float]
    """Wall time of each stage of the last attempt."""
    error: str | None
    """The last attempt's, or None where the model is there."""
    jobs: int | None = None
    """Videos at a time in the run that fitted it; None of runs that did not note it."""
    clip: str | None = None
    """`Video.digest` of what it was fitted to; None of runs that did not note it."""


@dataclass(frozen=True)
class Task:
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
        """Fits and exports the video. A command that fails is an outcome, not an exception.

        Args:
            number: of the attempt, from 1.
            threads: of OpenMP, and so of torch.
            variables: further ones of the commands' environment.
        """
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
        seconds, environment = {}, {**os.environ, "OMP_NUM_THREADS": str(threads), **variables}
        with open(self.folder / "log.txt", "wb") as log:
            for stage, command in self.commands.items():
                begin, line = time.monotonic(), [sys.executable, *command, *arguments[stage]]
                code = subprocess.run(line, stdout=log, stderr=log, env=environment, check=False).returncode
                seconds[stage] = round(time.monotonic() - begin, 1)
                if code:
                    return Outcome(self.name, number, seconds, self._why(stage, code))
        self._keep(run, model)
        return Outcome(self.name, number, seconds, None)

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

    def _why(self, stage: str, code: int) -> str:
        how = f"was killed by signal {-code}" if code < 0 else f"ended with exit code {code}"
        lines = (self.folder / "log.txt").read_text(encoding="utf-8", errors="replace").split("\n")
        said = [line.strip() for line in lines if line.startswith("Error")]
        return f"{stage} {how}" + (f": {said[-1]}" if said else f"; see {self.folder / 'log.txt'}")


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

"""One video of a benchmark: from its frames to `models/<video>.onnx`. Done once, however often it is asked for.

OUT/bench.json                 what is fitted, and how: one answer for the whole folder
OUT/models/<video>.onnx        appears when the task is finished, and only then
OUT/videos/<video>/task.json   how it went: attempts, seconds of each stage, the error of the last attempt
OUT/videos/<video>/log.txt     what the commands printed in the last attempt
OUT/videos/<video>/run/        the run, as decomo-train leaves it
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from decomo_eval.dataset import Video, write_frames
from decomo_eval.errors import DatasetError
from decomotion.errors import InputError
from decomotion.files import replacing

TRAIN = (sys.executable, "-m", "decomotion.cli")
EXPORT = (sys.executable, "-m", "decomo_export.cli")
"""The commands, as processes of their own: what kills one of them leaves the others alone."""


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


@dataclass(frozen=True)
class Task:
    """A video to be fitted."""

    name: str
    """Of the video."""
    out: Path
    """The benchmark's folder."""
    options: tuple[str, ...]
    """Of decomo-train."""
    attempts: int
    """How often it is tried."""

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

    def run(self, read: Callable[[str], Video]) -> Outcome:
        """Fits and exports the video, unless that is done; tries again after a failure. Never raises for one.

        Args:
            read: gives the video by its name.
        """
        if self.model.is_file():
            return self._finished_before()
        outcome = Outcome(self.name, 0, {}, "not tried")
        for attempt in range(1, self.attempts + 1):
            outcome = self._attempt(attempt, read)
            with replacing(self.folder / "task.json") as temporary:
                temporary.write_text(json.dumps(asdict(outcome), indent=2) + "\n", encoding="utf-8")
            if outcome.error is None:
                break
        return outcome

    def _finished_before(self) -> Outcome:
        report = self.folder / "task.json"
        known = json.loads(report.read_text(encoding="utf-8")) if report.is_file() else {}
        return Outcome(self.name, 0, known.get("seconds", {}), None)

    def _attempt(self, attempt: int, read: Callable[[str], Video]) -> Outcome:
        run, frames, seconds = self.folder / "run", self.folder / "frames" / self.name, {}
        shutil.rmtree(run, ignore_errors=True)  # of an attempt that was cut off; what it prepared is in the cache
        try:
            write_frames(read(self.name), frames)
        except InputError as error:
            return Outcome(self.name, attempt, {}, str(error))
        partial = self.folder / f".{self.name}.partial.onnx"
        stages = {
            "train": [*TRAIN, str(frames), "--out", str(run), "--shots", "ignore", *self.options],
            "export": [*EXPORT, str(partial), "--run", str(run)],
        }
        with open(self.folder / "log.txt", "wb") as log:
            for stage, command in stages.items():
                begin = time.monotonic()
                code = subprocess.run(command, stdout=log, stderr=subprocess.STDOUT, check=False).returncode
                seconds[stage] = round(time.monotonic() - begin, 1)
                if code:
                    return Outcome(self.name, attempt, seconds, self._why(stage, code))
        shutil.rmtree(self.folder / "frames")
        self.model.parent.mkdir(parents=True, exist_ok=True)
        partial.replace(self.model)
        return Outcome(self.name, attempt, seconds, None)

    def _why(self, stage: str, code: int) -> str:
        how = f"was killed by signal {-code}" if code < 0 else f"ended with exit code {code}"
        lines = (self.folder / "log.txt").read_text(encoding="utf-8", errors="replace").split("\n")
        said = [line.strip() for line in lines if line.startswith("Error")]
        return f"{stage} {how}" + (f": {said[-1]}" if said else f"; see {self.folder / 'log.txt'}")


def command_options(
    preset: str, time_budget: str | None, steps: int | None, seed: int, overrides: Sequence[str]
) -> tuple[str, ...]:
    """decomo-train's options of every task."""
    budget = [*(["--time-budget", time_budget] if time_budget else []), *(["--steps", str(steps)] if steps else [])]
    settings = [part for override in overrides for part in ("--set", override)]
    return ("--preset", preset, "--seed", str(seed), *budget, *settings)

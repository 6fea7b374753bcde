"""One clip of many: from its frames to a model. Done once, however often it is asked for.

OUT/models/<name>.onnx         appears when the model is finished, and only then; models/<name>/ of several windows
OUT/videos/<name>/task.json    how it went: attempts, seconds of each stage, the error of the last attempt
OUT/videos/<name>/log.txt      what the commands printed in the last attempt
OUT/videos/<name>/run/         the run, as decomo-train leaves it
OUT/videos/<name>/made.json    the clip's digest and the options that these were made with

An attempt works in a folder of its own, `.attempt-*`, and what it makes is moved to its place at the end: one that was
given up for lost, but still runs somewhere, spoils nothing. The next attempt goes on with what the last one has left.
"""

from __future__ import annotations

import json
import platform
import shutil
import uuid
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from decomotion.clip import clip_part
from decomotion.errors import CheckpointError, InputError
from decomotion.files import replacing
from decomotion.jobs.task import Outcome, Place, run_stages
from decomotion.presets import AUTO
from decomotion.windows import FILE_NAME as WINDOWS

COMMANDS: Mapping[str, tuple[str, ...]] = {"train": ("-m", "decomotion.cli"), "export": ("-m", "decomo_export.cli")}
"""Arguments of python, by stage. A stage is a process of its own: what kills one leaves the others alone."""
MODEL = ".onnx"
MADE = "made.json"
REMEDY = "move it away to fit it anew, or give another --out"


@dataclass(frozen=True)
class ClipTask:
    """A clip to be fitted."""

    name: str
    """Of the clip, and of what is made of it."""
    out: Path
    """The folder of all clips, in full: attempts run in other folders and, on a cluster, on other machines."""
    source: str
    """Path of the clip, CLIP or CLIP@A:B, in full."""
    options: tuple[str, ...]
    """Of decomo-train."""
    attempts: int
    """How often it is tried."""
    clip: str | None = None
    """Digest of the clip; an attempt needs it."""
    prepared: str = AUTO
    """What becomes of what the fit has prepared: decomo-train's option, which does not decide the result."""
    commands: Mapping[str, tuple[str, ...]] = field(default_factory=lambda: COMMANDS)

    def __post_init__(self) -> None:
        if not self.name or Path(self.name).name != self.name or self.name.startswith("."):
            raise InputError(f"the clip {self.name!r} has a name that cannot be a file's; rename it")

    @property
    def model(self) -> Path:
        """Where the model is: a file, or the folder of several windows'; the file where it is not there yet."""
        return model_in(self.out / "models", self.name)

    @property
    def folder(self) -> Path:
        """All else."""
        return self.out / "videos" / self.name

    def attempt(self, number: int, place: Place) -> Outcome:
        """Does what is not done: see `decomotion.jobs.task.Task`."""
        path, *_ = clip_part(Path(self.source))
        if not path.exists():
            where = f"{path} is not there on {platform.node()}"
            return Outcome(self.name, number, {}, f"{where}; it has to be in a folder that all machines share")
        here = self._begin()
        ended = run_stages(self.stages(here), self.folder / "log.txt", place)
        if ended.error is None or is_model(model_in(here, self.name)):
            self._keep(here)
        elif ended.refused == "train":  # what does not go on with itself is begun anew
            shutil.rmtree(here, ignore_errors=True)
        return Outcome(self.name, number, ended.seconds, ended.error)

    def stages(self, here: Path) -> Iterator[tuple[str, Sequence[str]]]:
        """What is still to be done by an attempt in the folder `here`, each asked for when the last has ended."""
        run = here / "run"
        if is_model(self.model) or is_model(model_in(here, self.name)):
            return
        if not _is_finished(run):
            going_on = ["--resume"] if _is_begun(run) else []
            prepared = [] if self.prepared == AUTO else ["--prepared", self.prepared]
            line = [*self.commands["train"], self.source, "--out", str(run), *self.options]
            yield "train", [*line, *prepared, *going_on]
        target = here / (self.name if (run / WINDOWS).is_file() else f"{self.name}{MODEL}")
        yield "export", [*self.commands["export"], str(target), "--run", str(run)]

    def results(self, here: Path) -> Mapping[Path, Path]:
        """What an attempt in the folder `here` may have made, and where it belongs, what counts last."""
        made = model_in(here, self.name)
        return {here / "run": self.folder / "run", made: self.out / "models" / made.name}

    def is_done(self) -> bool:
        """Whether all that is to be made is in its place."""
        return is_model(self.model)

    def record(self, outcome: Outcome) -> None:
        """Writes `task.json`."""
        with replacing(self.folder / "task.json") as temporary:
            temporary.write_text(json.dumps(asdict(outcome), indent=2) + "\n", encoding="utf-8")

    def recorded(self) -> Outcome | None:
        """What `task.json` says of an earlier run, as of one that needs no attempt; None where there is none."""
        known = read_json(self.folder / "task.json")
        if not known:
            return None
        return Outcome(self.name, 0, known.get("seconds", {}), known.get("error"), known.get("jobs"), known.get("clip"))

    def done_before(self) -> Outcome | None:
        """How it went in an earlier run, where all is there; a failure where the model is of or with something else."""
        if not is_model(self.model):
            return None
        known = self.recorded() or Outcome(self.name, 0, {}, None)
        differs = self._differs({"clip": known.clip, **read_json(self.folder / MADE)})
        return replace(known, error=differs) if differs or self.is_done() else None

    def made_with(self) -> dict[str, Any]:
        """What decides the result; `made.json`."""
        return {"clip": self.clip, "options": list(self.options)}

    def _differs(self, made: Mapping[str, Any]) -> str | None:
        """Why a model that was made with `made` is not this task's."""
        if None not in (self.clip, made["clip"]) and made["clip"] != self.clip:
            return f"{self.model} was fitted to other frames than the clip has now; {REMEDY}"
        if made.get("options", list(self.options)) != list(self.options):
            return f"{self.model} was fitted with other options; {REMEDY}"
        return None

    def _begin(self) -> Path:
        """The folder of a new attempt, with what the last one of the same clip and options has left."""
        here = self.folder / f".attempt-{uuid.uuid4().hex[:8]}"
        self.folder.mkdir(parents=True, exist_ok=True)
        for left in sorted(self.folder.glob(".attempt-*"), key=_last_change, reverse=True):
            if not here.exists() and read_json(left / MADE) == self.made_with():
                with suppress(OSError):
                    left.rename(here)
            shutil.rmtree(left, ignore_errors=True)
        here.mkdir(exist_ok=True)
        (here / "run" / ".decomo-train.lock").unlink(missing_ok=True)  # of one that was lost, but runs
        (here / MADE).write_text(json.dumps(self.made_with()), encoding="utf-8")
        return here

    def _keep(self, here: Path) -> None:
        (self.folder / MADE).write_text(json.dumps(self.made_with()), encoding="utf-8")
        for made, kept in self.results(here).items():
            if made.exists():
                kept.parent.mkdir(parents=True, exist_ok=True)
                if kept.is_dir():
                    shutil.rmtree(kept, ignore_errors=True)
                made.replace(kept)
        shutil.rmtree(here, ignore_errors=True)


def is_model(path: Path) -> bool:
    """Whether a model is there, whole."""
    return path.is_file() or (path / WINDOWS).is_file()


def model_in(folder: Path, name: str) -> Path:
    """Where in a folder the model of that name is; where it would be as a file if there is none."""
    file, windows = folder / f"{name}{MODEL}", folder / name
    return windows if not file.is_file() and (windows / WINDOWS).is_file() else file


def _is_begun(run: Path) -> bool:
    """Whether decomo-train has to be told that it goes on: with several windows it does by itself."""
    from decomotion.record import FILE_NAME

    return (run / FILE_NAME).is_file()


def _is_finished(run: Path) -> bool:
    from decomotion.record import is_finished

    try:
        return is_finished(run)
    except CheckpointError:  # decomo-train says so
        return False


def _last_change(attempt: Path) -> float:
    run = attempt / "run"
    return (run if run.is_dir() else attempt).stat().st_mtime


def read_json(file: Path) -> dict[str, Any]:
    """Empty where there is none, or one that was cut short."""
    try:
        content = json.loads(file.read_bytes())
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}

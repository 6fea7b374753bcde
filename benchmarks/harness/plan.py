"""Measurements that are made once: records of a configuration, and one fit of a clip that several of them ask."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from types import MappingProxyType

import click

from decomotion import checkpoint, record
from decomotion import config as configuration
from decomotion.errors import InputError
from decomotion.windows import FILE_NAME
from harness.records import Record, config_digest, is_done, provenance, write_record
from harness.usage import StageError, measured, toolkit

FITS = "fits"
"""Folder of the records of fits."""


@dataclass(frozen=True)
class Plan:
    """A configuration and its budget, and where records and runs go."""

    out: Path
    """Folder of the records: `<name>/<part>/<clip>.json`."""
    work: Path
    """Folder of runs and models, which may be removed when all is measured."""
    name: str
    preset: str
    overrides: tuple[str, ...]
    budget: tuple[str, ...]
    """Options of decomo-train; none: its default."""
    failures: list[str] = field(default_factory=list)
    """Parts and clips whose commands failed."""
    _unfitted: set[str] = field(default_factory=set)

    @cached_property
    def facts(self) -> Record:
        """What a fit's records say of it."""
        config = configuration.load(self.preset, overrides=self.overrides)
        budget = " ".join(self.budget) or "default"
        return {
            "preset": self.preset,
            "overrides": list(self.overrides),
            "config": config_digest(config),
            "budget": budget,
        }

    @property
    def options(self) -> list[str]:
        """Of decomo-train and decomo-prepare, but for the budget."""
        return ["--preset", self.preset, *(part for override in self.overrides for part in ("--set", override))]

    def folder(self, name: str, facts: Record) -> Path:
        """Where what belongs to a record of these facts is made."""
        digest = hashlib.sha256(json.dumps(facts).encode()).hexdigest()[:8]
        return self.work / self.name / f"{name}-{digest}"

    def record(self, part: str, clip: str, facts: Record, measure: Callable[[], Record], name: str = "") -> None:
        """Writes the record of a clip with what `measure` gives, where it is not there yet.

        Where a command fails, or what it made is refused, says so and notes it in `failures`.
        """
        try:
            self._record(part, clip, facts, measure, name)
        except (StageError, InputError) as error:
            self.failures.append(f"{part} {clip}")
            click.echo(f"Error: {part} {clip}: {error}", err=True)

    def _record(self, part: str, clip: str, facts: Record, measure: Callable[[], Record], name: str = "") -> None:
        path = self.out / (name or self.name) / part / f"{clip}.json"
        facts = {"row": part, "clip": clip, **facts}
        if is_done(path, facts):
            return
        click.echo(f"{part} {clip}")
        about = facts | provenance()
        write_record(path, about | measure())

    def fit(self, clip: str, frames: Path) -> Path:
        """The exported model of a clip, fitted where that is not done; a stopped fit goes on.

        Raises `StageError` where that fails, or did in this process.
        """
        if clip in self._unfitted:
            raise StageError("its fit failed")
        here = self.folder(clip, self.facts)
        run = here / "run"

        def measure() -> Record:
            training = stage(here / "train.json", lambda: train(frames, run, self.options, self.budget))
            exporting = stage(
                here / "export.json", lambda: measured(toolkit("decomo-export", model(run), "--run", run))
            )
            return {"stages": {"train": training, "export": exporting}, "model_bytes": size(model(run))}

        if not (here / "export.json").is_file():
            (self.out / self.name / FITS / f"{clip}.json").unlink(missing_ok=True)  # of a model that is gone
        self._unfitted.add(clip)
        self._record(FITS, clip, self.facts, measure)
        self._unfitted.remove(clip)
        return model(run)


def stage(path: Path, measure: Callable[[], Record]) -> Record:
    """What `measure` gave when it was first called, kept in a file."""
    if not path.is_file():
        write_record(path, measure())
    return json.loads(path.read_text())


def timed(figures: Callable[..., Record], *arguments: object) -> Record:
    """What `figures` gives, and the seconds that it takes."""
    begin = time.monotonic()
    found = figures(*arguments)
    return {"stages": {"score": {"seconds": round(time.monotonic() - begin, 1)}}, **found}


def train(
    clip: Path,
    run: Path,
    options: Sequence[str],
    budget: Sequence[str],
    folders: Sequence[Path] = (),
    variables: Mapping[str, str] = MappingProxyType({}),
) -> Record:
    """Fits a clip, or goes on with a run that was stopped; what that took.

    Beside what `measured` gives, of this call alone where it `resumed`: number of windows, `steps`, and seconds of
    preparation and of all over all calls.
    """
    begun = any(run.rglob(record.FILE_NAME))
    one_window = not (run / FILE_NAME).is_file()  # of several the same command goes on
    how = ["--resume"] if begun and one_window else [*options, *budget]
    taken = measured(toolkit("decomo-train", clip, "--out", run, *how), folders, variables)
    made = [checkpoint.load(file).training for file in sorted(run.rglob(checkpoint.FILE_NAME))]
    return taken | {
        "resumed": begun,
        "windows": len(made),
        "steps": sum(training["step"] for training in made),
        "prepare_seconds": round(sum(training["prepared"] for training in made), 1),
        "fit_seconds": round(sum(training["elapsed"] for training in made), 1),
    }


def model(run: Path) -> Path:
    """Where the model of a run lies: a folder if that is of several windows."""
    return run.parent / ("model" if (run / FILE_NAME).is_file() else "model.onnx")


def size(path: Path) -> int:
    """Bytes of a model."""
    return sum(file.stat().st_size for file in (path.iterdir() if path.is_dir() else [path]))

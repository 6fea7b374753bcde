"""What an engine runs: tasks, each tried a few times, and how they went."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, Protocol, runtime_checkable

from decomotion.console import BAD_INPUT, ENDS_WITH_STDIN


@dataclass(frozen=True)
class Outcome:
    """How a task went."""

    name: str
    attempts: int
    """0: it was finished before."""
    seconds: dict[str, float]
    """Wall time of each stage, of the last attempt that came to it."""
    error: str | None
    """The last attempt's, or None where the result is there."""
    jobs: int | None = None
    """Tasks at a time in the run that did it; None where that was not noted."""
    clip: str | None = None
    """Digest of the clip that it is about; None where that was not noted."""

    @property
    def words(self) -> str:
        """How it went, for those who wait."""
        if self.error is not None:
            return f"failed: {self.error}"
        return "finished" if self.attempts else "was there"


@dataclass(frozen=True)
class Place:
    """Where an attempt runs, and what it may use there."""

    threads: int
    """Of OpenMP, and so of torch."""
    variables: Mapping[str, str] = field(default_factory=dict)
    """Further ones of the commands' environment."""
    lifeline: int | None = None
    """Read end of a pipe: when its other end is closed, the commands end. None: when this process ends."""


@runtime_checkable
class Task(Protocol):
    """A piece of work whose result lies in a folder that all machines share. It may be pickled."""

    @property
    def name(self) -> str:
        """Of the task."""
        ...

    @property
    def attempts(self) -> int:
        """How often it is tried."""
        ...

    def attempt(self, number: int, place: Place) -> Outcome:
        """Does it, the `number`th time, from 1. A command that fails is an outcome, not an exception."""
        ...


@dataclass(frozen=True)
class Ended:
    """How the stages of an attempt ended."""

    seconds: dict[str, float]
    """Wall time of each that began."""
    error: str | None
    """Why the last one failed; None where none did."""
    refused: str | None = None
    """The stage that refused what it was given, with exit code 2; None where none did."""


def run_stages(stages: Iterable[tuple[str, Sequence[str]]], log: Path | None, place: Place) -> Ended:
    """Runs python with each stage's arguments until one fails; the next stage is asked for when one has ended.

    What they print goes to the file `log`; None: to this process's own output.
    """
    seconds: dict[str, float] = {}
    environment = {**os.environ, "OMP_NUM_THREADS": str(place.threads), **place.variables}
    output = None if log is None else open(log, "wb")  # noqa: SIM115
    try:
        for stage, arguments in stages:
            begin = time.monotonic()
            code = _run([sys.executable, *arguments], output, environment, place.lifeline)
            seconds[stage] = round(time.monotonic() - begin, 1)
            if code:
                return Ended(seconds, _why(stage, code, log), stage if code == BAD_INPUT else None)
    finally:
        if output is not None:
            output.close()
    return Ended(seconds, None)


def _run(line: Sequence[str], output: BinaryIO | None, environment: Mapping[str, str], lifeline: int | None) -> int:
    """The exit code. Whatever ends this process ends the command too: its standard input, a pipe, is closed then."""
    environment = {**environment, ENDS_WITH_STDIN: "1"}
    stdin = subprocess.PIPE if lifeline is None else lifeline
    with subprocess.Popen(line, stdin=stdin, stdout=output, stderr=output, env=environment) as process:
        return process.wait()


def _why(stage: str, code: int, log: Path | None) -> str:
    how = f"was killed by signal {-code}" if code < 0 else f"ended with exit code {code}"
    if log is None:
        return f"{stage} {how}"
    lines = log.read_text(encoding="utf-8", errors="replace").split("\n")
    said = [line.strip() for line in lines if line.startswith("Error")]
    return f"{stage} {how}" + (f": {said[-1]}" if said else f"; see {log}")

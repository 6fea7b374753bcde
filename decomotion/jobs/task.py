"""What an engine runs: tasks, each tried a few times, and how they went."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Protocol, runtime_checkable

from decomotion.console import ENDS_WITH_STDIN


@dataclass(frozen=True)
class Outcome:
    """How a task went."""

    name: str
    attempts: int
    """0: it was finished before."""
    seconds: dict[str, float]
    """Wall time of each stage of the last attempt."""
    error: str | None
    """The last attempt's, or None where the result is there."""
    jobs: int | None = None
    """Tasks at a time in the run that did it; None where that was not noted."""
    clip: str | None = None
    """Digest of the clip that it is about; None where that was not noted."""


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

    def attempt(self, number: int, threads: int, variables: Mapping[str, str] = ...) -> Outcome:
        """Does it. A command that fails is an outcome, not an exception.

        Args:
            number: of the attempt, from 1.
            threads: of OpenMP, and so of torch.
            variables: further ones of the commands' environment.
        """
        ...


def run_stages(
    stages: Iterable[tuple[str, Sequence[str]]], log: Path | None, threads: int, variables: Mapping[str, str]
) -> tuple[dict[str, float], str | None]:
    """Runs python with each stage's arguments until one fails; returns their wall seconds, and why it failed.

    What they print goes to the file `log`; None: to this process's own output.
    """
    seconds: dict[str, float] = {}
    environment = {**os.environ, "OMP_NUM_THREADS": str(threads), **variables}
    output = None if log is None else open(log, "wb")  # noqa: SIM115
    try:
        for stage, arguments in stages:
            begin = time.monotonic()
            code = _run([sys.executable, *arguments], output, environment)
            seconds[stage] = round(time.monotonic() - begin, 1)
            if code:
                return seconds, _why(stage, code, log)
    finally:
        if output is not None:
            output.close()
    return seconds, None


def _run(line: Sequence[str], output: BinaryIO | None, environment: Mapping[str, str]) -> int:
    """The exit code. Whatever ends this process ends the command too: its standard input, a pipe, is closed then."""
    environment = {**environment, ENDS_WITH_STDIN: "1"}
    with subprocess.Popen(line, stdin=subprocess.PIPE, stdout=output, stderr=output, env=environment) as process:
        return process.wait()


def _why(stage: str, code: int, log: Path | None) -> str:
    how = f"was killed by signal {-code}" if code < 0 else f"ended with exit code {code}"
    if log is None:
        return f"{stage} {how}"
    lines = log.read_text(encoding="utf-8", errors="replace").split("\n")
    said = [line.strip() for line in lines if line.startswith("Error")]
    return f"{stage} {how}" + (f": {said[-1]}" if said else f"; see {log}")

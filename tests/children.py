"""Processes that tests start and end: signals as a terminal's child has them, and no wait without a bound."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Timer

SECONDS = 120
"""A child that lives longer is killed, which ends whoever reads what it prints."""
FIT_SECONDS = 400
"""The same of one that fits, on a machine that does much else."""


@contextmanager
def child(
    command: Sequence[str | Path], environment: Mapping[str, str] | None = None, seconds: float = SECONDS
) -> Iterator[subprocess.Popen]:
    """A process whose output is piped as text; at the end it has ended, or the test fails. It lives so long at most.

    What the tests' own parent ignores (nohup: SIGHUP; a shell's background: SIGINT) it does not.
    """
    process = subprocess.Popen(
        command,
        env=environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        preexec_fn=_default_signals,
    )
    watch = Timer(seconds, process.kill)
    watch.start()
    try:
        yield process
        process.communicate(timeout=SECONDS)
    finally:
        watch.cancel()
        process.kill()
        process.wait(SECONDS)


def run_with_all(
    command: Sequence[str | Path], folder: Path, environment: Mapping[str, str], seconds: float
) -> tuple[int, str]:
    """How a command ended, and what it printed, both streams in one. After `seconds` it is killed with all it started.

    Raises `subprocess.TimeoutExpired` then.
    """
    with subprocess.Popen(
        command,
        cwd=folder,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        encoding="utf-8",
        start_new_session=True,
    ) as process:
        try:
            printed, _ = process.communicate(timeout=seconds)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            raise
    return process.returncode, printed


def named_in(text: str) -> list[str]:
    """The commands of the processes that are given `text`; one that ends meanwhile is none."""
    found = []
    for file in Path("/proc").glob("[0-9]*/cmdline"):
        with suppress(FileNotFoundError, ProcessLookupError):
            found.append(file.read_text(errors="replace").replace("\0", " "))
    return [each for each in found if text in each]


def sleeper(seconds: float) -> subprocess.Popen:
    """A process that does nothing, and ends by itself."""
    command = [sys.executable, "-c", f"import time; time.sleep({seconds})"]
    return subprocess.Popen(command, stdin=subprocess.DEVNULL)


def _default_signals() -> None:
    for each in (signal.SIGHUP, signal.SIGINT, signal.SIGTERM):
        signal.signal(each, signal.SIG_DFL)

"""What commands take while they work: time, memory with all processes that they start, and folders on disk. Linux."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from types import MappingProxyType

from decomotion.console import ENDS_WITH_STDIN
from harness.records import Record

EVERY = 0.2
"""Seconds between two looks."""
GIB = 2**30


class StageError(RuntimeError):
    """A command failed; it has said why."""


@dataclass(frozen=True)
class Memory:
    """Bytes of some processes, pages that several share counted in each; 0 where not known."""

    resident: int = 0
    """Now, mapped files included."""
    most_of_one: int = 0
    """The most that one of them has had so far."""
    anonymous: int = 0
    """What no file backs, and cannot be dropped where memory is short."""


class Watch:
    """The most that a process and its descendants have in memory, and that folders take on disk, in bytes."""

    def __init__(self, process: int, folders: Sequence[Path] = ()) -> None:
        self._process, self._folders, self._stop = process, folders, threading.Event()
        self.disk = self.resident = self.anonymous = 0
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def finish(self) -> None:
        """Looks no more."""
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        disk_due = 0.0
        while True:
            memory = memory_of(descendants(self._process))
            self.resident = max(self.resident, memory.resident, memory.most_of_one)
            self.anonymous = max(self.anonymous, memory.anonymous)
            begin = time.monotonic()
            if begin >= disk_due:
                self.disk = max(self.disk, sum(map(disk_of, self._folders)))
                taken = time.monotonic() - begin
                disk_due = begin + 20 * taken  # of many files no more than a twentieth of the time
            if self._stop.wait(EVERY):
                return


def descendants(process: int) -> list[int]:
    """A process, those that it started, those that these started and so on."""
    children: dict[int, list[int]] = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            parent = int(stat.read_text().rpartition(")")[2].split()[1])
            children.setdefault(parent, []).append(int(stat.parent.name))
    found = [process]
    for each in found:
        found += children.get(each, [])
    return found


def memory_of(processes: Sequence[int]) -> Memory:
    """Of all these together."""
    found = {"VmRSS": [0], "VmHWM": [0], "RssAnon": [0]}
    for process in processes:
        with suppress(OSError):
            for name, kibibytes in re.findall(r"(\w+):\s+(\d+) kB", Path(f"/proc/{process}/status").read_text()):
                if name in found:
                    found[name].append(int(kibibytes) * 1024)
    return Memory(sum(found["VmRSS"]), max(found["VmHWM"]), sum(found["RssAnon"]))


def disk_of(folder: Path) -> int:
    """Bytes that the files below a folder take; what is removed meanwhile does not count."""
    size = 0
    for parent, _, names in os.walk(folder):
        for name in names:
            with suppress(OSError):
                size += Path(parent, name).stat().st_blocks * 512
    return size


def toolkit(command: str, *arguments: object) -> list[str]:
    """The line that runs a command of this toolkit, as of this source tree."""
    (point,) = entry_points(group="console_scripts", name=command)
    code = f"import sys; from {point.module} import {point.attr}; sys.exit({point.attr}())"
    return [sys.executable, "-c", code, *map(str, arguments)]


def measured(
    line: Sequence[str], folders: Sequence[Path] = (), variables: Mapping[str, str] = MappingProxyType({})
) -> Record:
    """Runs a command: seconds of wall and of processors, the most memory and, of `folders`, disk in GiB.

    Raises `StageError` where it fails.
    """
    begin = time.monotonic()
    environment = {**os.environ, **variables, ENDS_WITH_STDIN: "1"}
    with subprocess.Popen(line, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, env=environment) as process:
        watch = Watch(process.pid, folders)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        watch.finish()
    if process.returncode:
        raise StageError(f"{' '.join(line)} failed")
    record = {
        "seconds": round(time.monotonic() - begin, 1),
        "cpu_seconds": round(usage.ru_utime + usage.ru_stime, 1),
        "peak_rss_gib": round(watch.resident / GIB, 2),
        "peak_anonymous_gib": round(watch.anonymous / GIB, 2),
    }
    return record | ({"peak_disk_gib": round(watch.disk / GIB, 3)} if folders else {})

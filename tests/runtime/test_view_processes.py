"""How the commands of a refit are begun and ended; Windows' way on Linux, with a stand-in for its `taskkill`."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from decomo_runtime.view import processes
from refitting import lives, wait_until

WITH_CHILD = """
import subprocess, sys, time
child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
print(child.pid, flush=True)
"""
OBEDIENT = f"{WITH_CHILD}sys.stdin.read(); child.kill(); child.wait()"
STUBBORN = f"{WITH_CHILD}time.sleep(600)"
TASKKILL = """#!/bin/sh
echo "$@" >> "$TASKKILLED"
for child in $(cat /proc/$4/task/$4/children); do kill -9 $child; done
kill -9 $4
"""


@pytest.fixture
def asked_to_kill(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """What a stand-in for `taskkill` was asked, a line each."""
    if sys.platform != "linux":
        pytest.skip("reads /proc")
    said = tmp_path / "said"
    said.touch()
    (tmp_path / "taskkill").write_text(TASKKILL)
    (tmp_path / "taskkill").chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("TASKKILLED", str(said))
    return said


def begun(program: str) -> tuple[subprocess.Popen[bytes], int]:
    """A process, and the id of its child."""
    process = processes.begin([sys.executable, "-c", program])
    assert process.stdout is not None
    return process, int(process.stdout.readline())


@pytest.mark.parametrize("program", [OBEDIENT, STUBBORN])
def test_a_process_ends_with_all_that_it_began(program: str):
    process, child = begun(program)
    with process:
        processes.end(process)
    assert process.returncode != 0
    wait_until(lambda: not lives(child))


@pytest.mark.parametrize(("program", "killed"), [(OBEDIENT, False), (STUBBORN, True)])
def test_on_windows_it_is_asked_by_its_input_and_killed_by_its_tree(
    program: str, killed: bool, asked_to_kill: Path, monkeypatch: pytest.MonkeyPatch
):
    process, child = begun(program)
    monkeypatch.setattr(processes, "ON_WINDOWS", True)
    monkeypatch.setattr(processes, "PATIENCE", 3.0 if killed else 60.0)  # one that obeys may be slow
    with process:
        processes.end(process)
    wait_until(lambda: not lives(child))
    assert asked_to_kill.read_text() == (f"/F /T /PID {process.pid}\n" if killed else "")


@pytest.mark.parametrize("windows", [False, True])
def test_a_process_is_not_interrupted_with_ours(windows: bool, monkeypatch: pytest.MonkeyPatch):
    asked: dict[str, Any] = {}
    monkeypatch.setattr(processes, "ON_WINDOWS", windows)
    monkeypatch.setattr(processes.subprocess, "Popen", lambda command, **options: asked.update(options))
    processes.begin(["decomo-train"])
    assert asked["creationflags"] == (processes.NEW_GROUP if windows else 0)
    assert asked["start_new_session"] is not windows

"""A command as a process of its own, that can be ended with all that it began.

On POSIX by its group: it is asked by a signal, then killed. Windows has no signal that asks: there the command's
standard input is closed, which our commands hear (`decomotion/console.py`), and then the tree below it is killed.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from decomotion.console import ENDS_WITH_STDIN

PATIENCE = 5.0
"""Seconds in which processes that are told to end must do so before they are killed."""
ON_WINDOWS = sys.platform == "win32"
NEW_GROUP = 0x200
"""CREATE_NEW_PROCESS_GROUP of Windows: Ctrl-C in our console is not for the command."""


def begin(command: Sequence[str | Path]) -> subprocess.Popen[bytes]:
    """Starts a command; what it prints, both streams in one, is a pipe.

    Nothing is ever written to its input, which closes when this process ends, and so ends the command.
    """
    return subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        env={**os.environ, ENDS_WITH_STDIN: "1"},
        start_new_session=not ON_WINDOWS,
        creationflags=NEW_GROUP if ON_WINDOWS else 0,
    )


def end(process: subprocess.Popen[bytes]) -> None:
    """Ends a process of `begin`, if it has not ended, and all that it began: asked first, then killed."""
    if ON_WINDOWS:
        _end_tree(process)
    else:
        _end_group(process)
    process.wait(PATIENCE)


def _end_group(process: subprocess.Popen[bytes]) -> None:
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGTERM)
        with suppress(subprocess.TimeoutExpired):
            process.wait(PATIENCE)
        os.killpg(process.pid, signal.SIGKILL)


def _end_tree(process: subprocess.Popen[bytes]) -> None:
    assert process.stdin is not None
    process.stdin.close()
    with suppress(subprocess.TimeoutExpired):
        process.wait(PATIENCE)
        return
    kill = ["taskkill", "/F", "/T", "/PID", str(process.pid)]
    subprocess.run(kill, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, timeout=PATIENCE, check=False)

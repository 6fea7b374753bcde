"""Commands that are started in a process which has torch already: for all of a session it is loaded once.

Nothing of ours is loaded before a command is: it is imported, run and ended as in a process of its own.
"""

from __future__ import annotations

import atexit
import json
import os
import select
import signal
import socket
import sys
import threading
import traceback
from contextlib import suppress
from importlib import import_module
from pathlib import Path

ADDRESS = "DECOMO_TESTS_WARM"
"""The variable of the environment that says where `serve` listens."""
STREAMS = 3
"""Input, output and errors."""


def serve(address: Path) -> None:
    """Loads torch, says so in a line, then forks for each command that `call` hands over, until its input ends."""
    import torch  # noqa: F401

    signal.signal(signal.SIGCHLD, _reap)
    with socket.socket(socket.AF_UNIX) as door:
        door.bind(str(address))
        door.listen()
        print("ready", flush=True)
        while sys.stdin not in select.select([door, sys.stdin], [], [])[0]:
            line, _ = door.accept()
            if os.fork() == 0:
                door.close()
                _run(line)
            line.close()


def call(module: str, function: str) -> int:
    """Has the command run with the arguments, streams, folder and environment of this process; how it ended."""
    with socket.socket(socket.AF_UNIX) as line:
        line.connect(os.environ[ADDRESS])
        task = json.dumps([module, function, sys.argv, str(Path.cwd()), dict(os.environ)]).encode()
        socket.send_fds(line, [len(task).to_bytes(8)], range(STREAMS))
        line.sendall(task)
        return int(line.makefile().read())


def _run(line: socket.socket) -> None:
    """In the fork: runs what `line` asks for and ends. Where the other end is gone, all that it started ends too."""
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    os.setsid()
    size, streams, _, _ = socket.recv_fds(line, 8, STREAMS)
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
        os.close(stream)
    task = line.makefile("rb").read(int.from_bytes(size))
    module, function, sys.argv, folder, environment = json.loads(task)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    sys.path[:0] = environment.get("PYTHONPATH", "").split(os.pathsep)
    threading.Thread(target=_end_with, args=[line], daemon=True).start()
    try:
        code = getattr(import_module(module), function)()
    except SystemExit as end:
        code = end.code
    except BaseException:
        traceback.print_exc()
        code = 1
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    line.sendall(str(int(code or 0)).encode())
    os._exit(0)


def _reap(*_: object) -> None:
    """Forgets children that have ended; their time is counted as this process's."""
    with suppress(ChildProcessError):
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass


def _end_with(line: socket.socket) -> None:
    line.recv(1)
    os.killpg(0, signal.SIGKILL)


if __name__ == "__main__":
    serve(Path(sys.argv[1]))

"""One run at a time in a folder."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from decomotion.errors import InputError


@contextmanager
def alone(folder: Path, command: str, error: type[InputError]) -> Iterator[None]:
    """Keeps other runs of `command` out of the folder, where its file system has locks.

    Raises `error` where one is at work on it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    lock = FileLock(folder / f".{command}.lock")
    try:
        lock.acquire(timeout=0)
    except Timeout as cause:
        raise error(f"another {command} is at work in {folder}; wait for it, or give another --out") from cause
    except (OSError, NotImplementedError):  # no locks in this network folder
        pass
    try:
        yield
    finally:
        lock.release()

"""One run at a time in a folder."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from decomotion.errors import InputError


@contextmanager
def alone(folder: Path, command: str, error: type[InputError]) -> Iterator[None]:
    """Keeps other runs of `command` out of the folder, where its file system has locks.

    Raises `error` where one is at work on it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with open(folder / f".{command}.lock", "w") as file:
        try:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as cause:
            raise error(f"another {command} is at work in {folder}; wait for it, or give another --out") from cause
        except (OSError, ModuleNotFoundError):  # no locks in this network folder, or none of this kind on this system
            pass
        yield

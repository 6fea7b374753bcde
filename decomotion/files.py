"""Files and folders appear whole or not at all: written to a temporary name beside the target and renamed."""

from __future__ import annotations

import errno
import hashlib
import os
import re
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

DISK_FAILURES = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS)
"""What a write may end in; such an error seldom names a file."""
WINDOWS_IN_USE = (5, 32)
"""Its codes of "access denied" and of a "sharing violation"."""
PAUSES = (0.05, 0.1, 0.2, 0.4, 0.8)
"""Seconds between attempts to rename what is in use."""


def digest_of(file: Path) -> str:
    """SHA-256 of its bytes, in hexadecimal digits."""
    with file.open("rb") as content:
        return hashlib.file_digest(content, "sha256").hexdigest()


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Yields a temporary path in the folder of `path`, with the same suffix; on success it becomes `path`.

    On an exception the temporary file is removed and `path` is left as it was; one of a disk that is full names `path`.
    """
    path = Path(path)
    temporary = partial_name(path)
    with naming(path, temporary):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            yield temporary
            with open(temporary, "rb+") as written:
                os.fsync(written.fileno())
            put_in_place(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)


@contextmanager
def new_folder(path: str | Path) -> Iterator[Path]:
    """Yields a temporary, empty folder beside `path`; on success it becomes `path`.

    `path` must not exist yet or be an empty folder: `OSError` otherwise. On an exception nothing is left; one of a disk
    that is full names `path`.
    """
    shown, path = path, Path(path).absolute()  # "." has no name
    temporary = partial_name(path)
    with naming(shown, temporary):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            temporary.mkdir()
            yield temporary
            put_in_place(temporary, path)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)


def put_in_place(temporary: Path, path: Path) -> None:
    """Renames a file or folder; `path` may be a file in place of a file, or an empty folder in place of a folder.

    Windows renames nothing that is open, onto nothing that is open, and no folder onto another: waits up to a second or
    two for scanners and the like, then raises an `OSError` that names `path`.
    """
    if temporary.is_dir() and path.is_dir():
        path.rmdir()
    for pause in (*PAUSES, None):
        try:
            temporary.replace(path)
            return
        except PermissionError as error:
            if getattr(error, "winerror", None) not in WINDOWS_IN_USE:
                raise
            if pause is None:
                reason = "it is open in another program; close it there"
                raise OSError(error.errno, reason, str(path)) from error
            time.sleep(pause)


def check_room(path: Path, size: int) -> None:
    """Raises what a full disk's write would, an `OSError`, unless a new file `path` may grow to `size` bytes.

    For libraries that crash, wait for ever or leave half a file there. Looks where the system can (`posix_fallocate`).
    """
    if hasattr(os, "posix_fallocate"):
        try:
            with path.open("wb") as file:
                os.posix_fallocate(file.fileno(), 0, size)
        finally:
            path.unlink(missing_ok=True)


def partial_name(path: Path) -> Path:
    """What is beside `path` while it is written, with the same suffix."""
    return path.with_name(f".{path.stem}.{os.getpid()}.partial{path.suffix}")


@contextmanager
def naming(path: str | Path, temporary: str | Path | None = None) -> Iterator[None]:
    """A write of the block that fails, as on a full disk, raises an `OSError` that names `path`.

    It may be any of `DISK_FAILURES`, numpy's short write, which has no number, or what a library made of one of them.
    Errors that name a file themselves are left alone, unless it is `temporary` or lies in it; default: `path`.
    """
    try:
        yield
    except (OSError, RuntimeError) as error:
        failure = _failed_write(error)
        if failure is None or not _nameless(failure, Path(temporary or path)):
            raise
        reason = failure.strerror or f"not written whole, is the disk full? ({failure})"
        raise OSError(failure.errno or errno.EIO, reason, str(path)) from error


def _failed_write(error: BaseException | None) -> OSError | None:
    """The failed write among an error and those that it hides: torch raises a `RuntimeError` while handling one."""
    while error is not None:
        if isinstance(error, OSError) and (error.errno in DISK_FAILURES or _is_short_write(error)):
            return error
        error = error.__cause__ or error.__context__
    return None


def _is_short_write(error: OSError) -> bool:
    return error.errno is None and re.fullmatch(r"\d+ requested and \d+ written", str(error)) is not None


def _nameless(error: OSError, temporary: Path) -> bool:
    name = error.filename2 or error.filename  # of two, what is written is the second
    return name is None or Path(os.fsdecode(name)).absolute().is_relative_to(temporary.absolute())

"""What Windows does not allow of files, for tests on Linux: a rename of what is open, or onto what is there."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

SHARING_VIOLATION = 32
FORBIDDEN = set('<>:"|?*')
"""In names of files."""


class SharingError(PermissionError):
    """As Windows raises it."""

    winerror = SHARING_VIOLATION


def open_below(path: str | os.PathLike[str]) -> list[str]:
    """Files that this process has open or mapped, `path` or within it."""
    root = Path(path).absolute()
    with open("/proc/self/maps", encoding="utf-8") as maps:
        names = {line.split(maxsplit=5)[5].strip() for line in maps if len(line.split(maxsplit=5)) == 6}
    for entry in Path("/proc/self/fd").iterdir():
        try:
            names.add(str(entry.readlink()))
        except FileNotFoundError:  # the listing's own
            continue
    return sorted(name for name in names if Path(name).is_absolute() and Path(name).is_relative_to(root))


@contextmanager
def windows_rules() -> Iterator[list[str]]:
    """Within it the rules hold for `os.rename`, `os.replace` and names of new files; yields the names of all renamed.

    Each violation raises what Windows would. Skips where there is no /proc.
    """
    if sys.platform != "linux":
        pytest.skip("reads /proc")
    renamed: list[str] = []

    def keeping(act: Callable[..., None], onto_files: bool) -> Callable[..., None]:
        def rename(source: Any, target: Any, **more: Any) -> None:
            for path in (source, target):
                if FORBIDDEN & set(Path(path).name):
                    raise OSError(errno.EINVAL, "The filename is incorrect", os.fspath(path))
                if held := open_below(path):
                    raise SharingError(errno.EACCES, f"is open: {held}", os.fspath(source), None, os.fspath(target))
            if os.path.lexists(target) and (not onto_files or Path(target).is_dir()):
                raise SharingError(errno.EACCES, "is there", os.fspath(source), None, os.fspath(target))
            renamed.append(os.fspath(target))
            act(source, target, **more)

        return rename

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "rename", keeping(os.rename, False))
        patch.setattr(os, "replace", keeping(os.replace, True))
        yield renamed

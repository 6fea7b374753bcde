"""Refuses output paths that could not be written, before any work is done for them."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Sequence
from pathlib import Path

from decomotion.errors import OutputError
from decomotion.files import partial_name


def check_output(option: str, path: Path, suffixes: Sequence[str] = ()) -> None:
    """`OutputError` unless `path` ends in one of `suffixes`, if any, and its folder is, or can be made, writable."""
    if suffixes and path.suffix.lower() not in suffixes:
        raise OutputError(f"{option} {path} must end in {' or '.join(suffixes)}")
    _check_writable(option, path, path.absolute().parent)
    if path.is_dir():
        raise OutputError(f"{option} {path} is a folder; give a file name inside it")


def check_not_input(option: str, path: Path, *inputs: Path | None) -> None:
    """`OutputError` where writing `path` would replace one of `inputs`, or the video of which one is a part."""
    for given in inputs:
        if given is None:
            continue
        source = given if given.exists() else Path(re.sub(r"@\d+:\d+$", "", str(given)))
        if path.exists() and source.exists() and path.samefile(source):
            raise OutputError(f"{option} {path} would replace {given}, which is read; give another name")


def check_folder(option: str, path: Path) -> None:
    """`OutputError` unless `path` is a folder, or can be made one, in which files may be written."""
    _check_writable(option, path, path.absolute())


def check_new_folder(option: str, path: Path) -> None:
    """`OutputError` unless a folder `path` can be made, or is there and empty."""
    _check_writable(option, path, path.absolute().parent)
    if path.exists() and not (path.is_dir() and not any(path.iterdir())):
        raise OutputError(f"{option} {path} exists already; give the name of a new folder, or empty that one")


def _check_writable(option: str, path: Path, folder: Path) -> None:
    """Tries it in `folder`, or in the nearest parent that is there: permissions do not tell of all file systems."""
    try:
        while not folder.exists():
            folder = folder.parent
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise OutputError(
            f"{option} {path} cannot be written ({error.strerror}): {folder} is not a folder that you may write to"
        ) from error
    try:
        partial_name(path.absolute()).lstat()
    except FileNotFoundError:
        pass
    except OSError as error:  # a name that is too long
        raise OutputError(f"{option} {path} cannot be written ({error.strerror}); give another name") from error

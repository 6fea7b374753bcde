"""Refuses output paths that could not be written, before any work is done for them."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path

from decomo_runtime.errors import TracksFileError


def check_output(option: str, path: Path, suffixes: Sequence[str]) -> None:
    """`TracksFileError` unless `path` ends in one of `suffixes` and its folder is, or can be made, writable."""
    if path.suffix.lower() not in suffixes:
        raise TracksFileError(f"{option} {path} must end in {' or '.join(suffixes)}")
    if path.is_dir():
        raise TracksFileError(f"{option} {path} is a folder; give a file name inside it")
    _check_writable(option, path)


def check_not_input(option: str, path: Path, *inputs: Path | None) -> None:
    """`TracksFileError` where writing `path` would replace one of `inputs`, or the video of which one is a part."""
    for given in inputs:
        if given is None:
            continue
        source = given if given.exists() else Path(re.sub(r"@\d+:\d+$", "", str(given)))
        if path.exists() and source.exists() and path.samefile(source):
            raise TracksFileError(f"{option} {path} would replace {given}, which is read; give another name")


def check_new_folder(option: str, path: Path) -> None:
    """`TracksFileError` unless a folder `path` can be made, or is there and empty."""
    if path.exists() and not (path.is_dir() and not any(path.iterdir())):
        raise TracksFileError(f"{option} {path} exists already; give the name of a new folder, or empty that one")
    _check_writable(option, path)


def _check_writable(option: str, path: Path) -> None:
    folder = next(parent for parent in path.absolute().parents if parent.exists())
    if not folder.is_dir() or not os.access(folder, os.W_OK | os.X_OK):
        raise TracksFileError(f"{option} {path} cannot be written: {folder} is not a folder that you may write to")

"""`.npy` and `.npz` files of plain arrays: nothing in them is executed, and damage is one sentence whatever it hit."""

from __future__ import annotations

import os
import zipfile
import zlib
from collections.abc import Container, Iterator
from contextlib import contextmanager
from pathlib import Path
from tokenize import TokenError
from typing import Any

import numpy as np
import numpy.typing as npt

from decomotion.errors import InputError
from decomotion.files import replacing

UNREADABLE = (ValueError, OSError, EOFError, RuntimeError, SyntaxError, TokenError, zipfile.BadZipFile, zlib.error)
"""What reading raises where a file is damaged or of another kind: of zipfile, of zlib, of numpy and of its headers."""


def read_npy(path: Path, error: type[InputError], remedy: str = "replace it") -> npt.NDArray[Any]:
    """The array of a file. Raises `error`, naming the remedy, where it is no .npy, is damaged, or holds objects."""
    try:
        with open(path, "rb") as file:
            return np.lib.format.read_array(file, allow_pickle=False)
    except UNREADABLE as cause:
        raise error(f"{path} is not an .npy file of a plain array, or is damaged ({cause}); {remedy}") from cause


def read_npz(
    path: Path, error: type[InputError], keys: Container[str] | None = None, remedy: str = "replace it"
) -> dict[str, npt.NDArray[Any]]:
    """The arrays of a file by key: all, or those of `keys` that it has.

    Raises `error`, naming the remedy, where it is no .npz, is damaged, or holds objects.
    """
    with _opened(path, error, remedy) as archive:
        return {key: archive[key] for key in archive.files if keys is None or key in keys}


def allocated_memmap(
    path: Path, dtype: npt.DTypeLike, shape: tuple[int, ...], *, keep: bool = False
) -> np.memmap[Any, Any]:
    """A new .npy file of zeros, mapped for reading and writing, for which the disk has room; `keep`: the one there.

    Raises `OSError`, naming `path`, where it has none: of a file with holes, storing into the map would kill the
    process. Then no file is left.
    """
    if keep:
        return np.lib.format.open_memmap(path, mode="r+")
    with replacing(path) as temporary:
        np.lib.format.open_memmap(temporary, mode="w+", dtype=dtype, shape=shape)
        if hasattr(os, "posix_fallocate"):
            with open(temporary, "rb+") as file:
                os.posix_fallocate(file.fileno(), 0, temporary.stat().st_size)
    return np.lib.format.open_memmap(path, mode="r+")


def npz_keys(path: Path, error: type[InputError], remedy: str = "replace it") -> list[str]:
    """The keys of a file, whose arrays are not read. Raises `error`, naming the remedy, where it is no .npz."""
    with _opened(path, error, remedy) as archive:
        return list(archive.files)


@contextmanager
def _opened(path: Path, error: type[InputError], remedy: str) -> Iterator[Any]:
    try:
        with zipfile.ZipFile(path), np.load(path, allow_pickle=False) as archive:
            yield archive
    except UNREADABLE as cause:
        raise error(f"{path} is not an .npz file of plain arrays, or is damaged ({cause}); {remedy}") from cause

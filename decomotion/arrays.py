"""`.npy` and `.npz` files of plain arrays: nothing in them is executed, and damage is one sentence whatever it hit."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Container, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from decomotion.errors import InputError
from decomotion.files import replacing

SUFFIX = ".npy"
"""Of the members of an .npz file, whose names without it are the keys."""


def read_npy(path: Path, error: type[InputError], remedy: str = "replace it") -> npt.NDArray[Any]:
    """The array of a file. Raises `error`, naming the remedy, where it is no .npy, is damaged, or holds objects."""
    with _told(f"{path} is not an .npy file of a plain array", error, remedy), open(path, "rb") as file:
        return np.lib.format.read_array(file, allow_pickle=False)


def read_npz(
    path: Path, error: type[InputError], keys: Container[str] | None = None, remedy: str = "replace it"
) -> dict[str, npt.NDArray[Any]]:
    """The arrays of a file by key: all, or those of `keys` that it has.

    Raises `error`, naming the remedy, where it is no .npz, is damaged, or holds objects.
    """
    with _opened(path, error, remedy) as (archive, found):
        arrays = {}
        for key in found:
            if keys is None or key in keys:
                with archive.open(key + SUFFIX) as member:
                    arrays[key] = np.lib.format.read_array(member, allow_pickle=False)
        return arrays


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
    with _opened(path, error, remedy) as (_, keys):
        return keys


@contextmanager
def _opened(path: Path, error: type[InputError], remedy: str) -> Iterator[tuple[zipfile.ZipFile, list[str]]]:
    """The archive and its keys."""
    with _told(f"{path} is not an .npz file of plain arrays", error, remedy), zipfile.ZipFile(path) as archive:
        names = archive.namelist()
        if len(set(names)) != len(names):
            raise zipfile.BadZipFile("it has two arrays of one name")
        if other := [name for name in names if not name.endswith(SUFFIX)]:
            raise zipfile.BadZipFile(f"it holds {other[0]!r}")
        yield archive, [name.removesuffix(SUFFIX) for name in names]


@contextmanager
def _told(what: str, error: type[InputError], remedy: str) -> Iterator[None]:
    """numpy, zipfile and what they decompress with raise whatever a damaged header brings them to."""
    try:
        yield
    except Exception as cause:
        raise error(f"{what}, or is damaged ({cause or type(cause).__name__}); {remedy}") from cause

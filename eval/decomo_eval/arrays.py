"""`.npz` files of plain arrays, read without executing anything in them."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Container, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from decomo_eval.errors import EvalError


def read_npz(path: Path, error: type[EvalError], keys: Container[str] | None = None) -> dict[str, npt.NDArray[Any]]:
    """The arrays of a file by key: all, or those of `keys` that it has.

    Raises `error` where it is no .npz, is damaged, or holds objects.
    """
    with _opened(path, error) as archive:
        return {key: archive[key] for key in archive.files if keys is None or key in keys}


def npz_keys(path: Path, error: type[EvalError]) -> list[str]:
    """The keys of a file, whose arrays are not read. Raises `error` where it is no .npz."""
    with _opened(path, error) as archive:
        return list(archive.files)


@contextmanager
def _opened(path: Path, error: type[EvalError]) -> Iterator[Any]:
    try:
        with zipfile.ZipFile(path), np.load(path, allow_pickle=False) as archive:
            yield archive
    except (OSError, EOFError, ValueError, zipfile.BadZipFile, zlib.error) as cause:
        raise error(f"{path} cannot be read as an .npz of plain arrays ({cause})") from cause

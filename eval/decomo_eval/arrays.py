"""`.npz` files of plain arrays, read without executing anything in them."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from decomo_eval.errors import EvalError


def read_npz(path: Path, error: type[EvalError]) -> dict[str, npt.NDArray[Any]]:
    """The arrays of a file by key. Raises `error` where it is no .npz, is damaged, or holds objects."""
    try:
        with zipfile.ZipFile(path), np.load(path, allow_pickle=False) as archive:
            return {key: archive[key] for key in archive.files}
    except (OSError, EOFError, ValueError, zipfile.BadZipFile, zlib.error) as cause:
        raise error(f"{path} cannot be read as an .npz of plain arrays ({cause})") from cause

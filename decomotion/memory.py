"""What becomes of the memory of large arrays that are freed, with glibc: kept for the next one, or given back.

glibc returns every array above 32 MiB to the system at once. The next one of that size is fetched page by page, which
takes longer than dense features need to be computed. Smaller ones leave gaps between those that stay.
"""

from __future__ import annotations

import ctypes
import mmap
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import numpy.typing as npt

_TRIM_THRESHOLD, _MMAP_THRESHOLD, _MMAP_MAX = -1, -3, -4
"""Of `mallopt`, from malloc.h."""
_KEPT = ((_MMAP_MAX, 0), (_TRIM_THRESHOLD, 2**31 - 1))
_USUAL = ((_MMAP_MAX, 65536), (_MMAP_THRESHOLD, 32 << 20), (_TRIM_THRESHOLD, 64 << 20))
"""The values to which glibc adapts where large arrays come and go."""
_RETURNED = ((_MMAP_THRESHOLD, 1 << 20),)


@contextmanager
def kept_memory() -> Iterator[None]:
    """Within it the process keeps memory that is freed; what it does not use afterwards goes back to the system.

    Does nothing where the C library is not glibc.
    """
    with _allocating(_KEPT):
        yield


@contextmanager
def returned_memory() -> Iterator[None]:
    """Within it each large array that is freed goes back to the system: where frames come and go among some that stay,
    what they leave between these would add up.

    Does nothing where the C library is not glibc.
    """
    with _allocating(_RETURNED):
        yield


@contextmanager
def _allocating(options: Sequence[tuple[int, int]]) -> Iterator[None]:
    """With these of `mallopt`, and as usual afterwards."""
    libc = _glibc()
    if libc is None:
        yield
        return
    for option, value in options:
        libc.mallopt(option, value)
    try:
        yield
    finally:
        for option, value in _USUAL:
            libc.mallopt(option, value)
        libc.malloc_trim(0)


def give_back() -> None:
    """What was kept and is not used goes back to the system: between parts that need memory of different shapes."""
    libc = _glibc()
    if libc is not None:
        libc.malloc_trim(0)


def forget(mapped: npt.NDArray[Any]) -> None:
    """What an array maps of a file leaves the process's memory: it stays in the file, and is read when asked for.

    Does nothing where the array, or what it is a part of, is not mapped.
    """
    part: Any = mapped
    while isinstance(part, np.ndarray):
        part = part.base
    if isinstance(part, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
        part.madvise(mmap.MADV_DONTNEED)


def _glibc() -> ctypes.CDLL | None:
    libc = ctypes.CDLL(None) if sys.platform == "linux" else None
    return libc if libc is not None and hasattr(libc, "mallopt") and hasattr(libc, "malloc_trim") else None

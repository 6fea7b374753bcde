"""How a call is cut into calls of the session, so that its memory stays within bounds."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from decomo_runtime.errors import QueryError

DEFAULT_MEMORY = 64 * 2**20
"""Bytes that one call of the session may work with; more is not faster, as it leaves the processor's caches."""


def query_chunks(
    count: int, chunk: int | None, frames: int, bytes_per_ray: int, max_memory: int | None
) -> Iterator[slice]:
    """Slices that cover `count` queries in order, each asked in `frames` frames at once.

    `chunk` is the number of queries in each; None: as many as `max_memory` bytes allow, one at least.
    """
    if chunk is None:
        rays = _memory(max_memory) // bytes_per_ray
        chunk = max(1, rays // (1 + frames))
    elif isinstance(chunk, bool) or not isinstance(chunk, int | np.integer) or chunk < 1:
        raise QueryError(f"chunk must be a whole number of queries, at least 1; got {chunk!r}")
    for start in range(0, count, int(chunk)):
        yield slice(start, min(count, start + int(chunk)))


def frame_chunks(count: int, bytes_per_ray: int, max_memory: int | None) -> Iterator[slice]:
    """Slices that cover `count` frames in order, of which one query can be asked at once.

    Raises `QueryError` where not even one query in one frame fits into `max_memory` bytes.
    """
    rays = _memory(max_memory) // bytes_per_ray
    if rays < 2:
        raise QueryError(
            f"max_memory={max_memory} is too little: this model needs {2 * bytes_per_ray} bytes for one point in one "
            "frame; give at least that"
        )
    for start in range(0, count, rays - 1):
        yield slice(start, min(count, start + rays - 1))


def _memory(max_memory: int | None) -> int:
    if max_memory is None:
        return DEFAULT_MEMORY
    if isinstance(max_memory, bool) or not isinstance(max_memory, int | np.integer) or max_memory < 1:
        raise QueryError(f"max_memory must be a whole number of bytes, at least 1; got {max_memory!r}")
    return int(max_memory)

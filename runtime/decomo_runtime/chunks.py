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

    `chunk` is the number of queries in each; None: as many as `max_memory` bytes allow. Raises `QueryError` where they
    do not allow one query, in one frame where it is asked in any.
    """
    if chunk is None:
        chunk = max(1, _rays(bytes_per_ray, max_memory, 1 + min(frames, 1)) // (1 + frames))
    elif isinstance(chunk, bool) or not isinstance(chunk, int | np.integer) or chunk < 1:
        raise QueryError(f"chunk must be a whole number of queries, at least 1; got {chunk!r}")
    for start in range(0, count, int(chunk)):
        yield slice(start, min(count, start + int(chunk)))


def frame_chunks(count: int, bytes_per_ray: int, max_memory: int | None) -> Iterator[slice]:
    """Slices that cover `count` frames in order, of which one query can be asked at once.

    Raises `QueryError` where not even one query in one frame fits into `max_memory` bytes.
    """
    rays = _rays(bytes_per_ray, max_memory, 2)
    for start in range(0, count, rays - 1):
        yield slice(start, min(count, start + rays - 1))


def _rays(bytes_per_ray: int, max_memory: int | None, least: int) -> int:
    """How many rays fit into the memory: at least so many."""
    rays = _memory(max_memory) // bytes_per_ray
    if rays < least:
        what = "one point in one frame" if least > 1 else "one point's appearance"
        raise QueryError(
            f"max_memory={max_memory} is too little: this model needs {least * bytes_per_ray} bytes for {what}; give "
            "at least that"
        )
    return rays


def _memory(max_memory: int | None) -> int:
    if max_memory is None:
        return DEFAULT_MEMORY
    if isinstance(max_memory, bool) or not isinstance(max_memory, int | np.integer) or max_memory < 1:
        raise QueryError(f"max_memory must be a whole number of bytes, at least 1; got {max_memory!r}")
    return int(max_memory)

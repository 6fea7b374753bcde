"""How calls are cut: every query and frame once, in order, as many at a time as the memory allows."""

from __future__ import annotations

import pytest

from decomo_runtime.chunks import frame_chunks, query_chunks
from decomo_runtime.errors import QueryError


def numbers(slices: list[slice]) -> list[list[int]]:
    return [list(range(part.start, part.stop)) for part in slices]


@pytest.mark.parametrize(
    ("count", "chunk", "frames", "memory", "expected"),
    [
        (5, 2, 3, None, [[0, 1], [2, 3], [4]]),
        (0, 2, 3, None, []),
        (5, None, 3, 80, [[0, 1], [2, 3], [4]]),  # of 10 bytes a ray: 8 rays, 4 a query, with its own
        (5, None, 3, 79, [[0], [1], [2], [3], [4]]),
        (5, None, 0, 30, [[0, 1, 2], [3, 4]]),  # without frames a query is one ray
        (3, None, 3, 20, [[0], [1], [2]]),  # at least one, in a single frame
        (4, None, 1, None, [[0, 1, 2, 3]]),
    ],
)
def test_queries(count: int, chunk: int | None, frames: int, memory: int | None, expected: list[list[int]]):
    assert numbers(list(query_chunks(count, chunk, frames, 10, memory))) == expected


@pytest.mark.parametrize(
    ("memory", "expected"), [(40, [[0, 1, 2], [3, 4]]), (20, [[0], [1], [2], [3], [4]]), (None, [[0, 1, 2, 3, 4]])]
)
def test_frames(memory: int | None, expected: list[list[int]]):
    """One ray is the query's own."""
    assert numbers(list(frame_chunks(5, 10, memory))) == expected


def test_too_little_memory_says_how_much_is_needed():
    with pytest.raises(QueryError, match="needs 20 bytes for one point in one frame"):
        list(query_chunks(3, None, 1, 10, 19))
    with pytest.raises(QueryError, match="needs 20 bytes for one point in one frame"):
        list(frame_chunks(3, 10, 19))
    with pytest.raises(QueryError, match="needs 10 bytes for one point's appearance"):
        list(query_chunks(3, None, 0, 10, 9))


@pytest.mark.parametrize("chunk", [0, -1, 1.5, True])
def test_a_chunk_is_a_number_of_queries(chunk: object):
    with pytest.raises(QueryError, match="chunk must be a whole number of queries, at least 1"):
        list(query_chunks(3, chunk, 1, 10, None))  # type: ignore[arg-type]

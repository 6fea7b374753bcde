"""Lines of markdown tables."""

from __future__ import annotations

from collections.abc import Iterator, Sequence


def line(cells: Sequence[str]) -> str:
    """A row."""
    return "| " + " | ".join(cells) + " |"


def head(titles: Sequence[str]) -> Iterator[str]:
    """The first two lines."""
    yield line(titles)
    yield "|---" * len(titles) + "|"

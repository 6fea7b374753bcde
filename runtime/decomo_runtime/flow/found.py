"""What a file of dense correspondence is written from."""

from __future__ import annotations

from dataclasses import dataclass

from decomo_runtime.dense import Dense


@dataclass(frozen=True, eq=False)
class Found:
    """Where the pixels of frame `origin` are in frame `target`."""

    dense: Dense
    origin: int
    target: int
    pixel_aspect: float = 1.0
    """Width of the clip's pixels over their height."""

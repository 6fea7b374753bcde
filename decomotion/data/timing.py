"""How long something takes on this machine."""

from __future__ import annotations

import time
from collections.abc import Callable

TRIALS, SECONDS = 2, 0.3
"""At least so many trials, and as many as begin within so many seconds."""


def least_seconds(task: Callable[[], object]) -> float:
    """Wall time of `task`, the least of some trials: other work on the machine makes them dearer, never cheaper."""
    trials = []
    while len(trials) < TRIALS or sum(trials) < SECONDS:
        begin = time.perf_counter()
        task()
        trials.append(time.perf_counter() - begin)
    return min(trials)

"""What linking costs on this machine, and how many points are affordable."""

from __future__ import annotations

import time

import numpy as np

from decomotion.data.links.linking import link
from decomotion.errors import SupervisionError

TRIALS = 2
FRAMES, POINTS, GAPS = 12, 2048, (1, 2, 4)
"""Of a trial."""
LINK_SHARE = 0.3
"""Share of the time for preparation that linking may take at least, however much flow has taken."""
REST_SHARE = 0.15
"""Share of it that is left for features and masks."""
MIN_POINTS = 256
"""Points a frame below which a pool is of no use."""
PATIENCE = 60.0
"""Seconds that linking may take in any case: only longer work is refused."""


def seconds_per_hop(height: int, width: int) -> float:
    """Wall time in which a point is carried over one gap, on flows of that raster: the least of some trials."""
    still = np.zeros((height, width, 2), np.float32)
    diagonal = np.linspace(0, 1, POINTS, dtype=np.float32)[:, None] * np.array([width - 1, height - 1], np.float32)
    points = np.repeat(diagonal[None], FRAMES, axis=0)
    seconds = []
    for _ in range(TRIALS):
        begin = time.perf_counter()
        for step in (1, -1):
            for _ in link(points, lambda *_: still, GAPS, cycle_threshold=1.0, max_gap=FRAMES, step=step):
                pass
        seconds.append(time.perf_counter() - begin)
    return min(seconds) / (POINTS * hops(FRAMES, len(GAPS), FRAMES))


def hops(frames: int, gaps: int, max_gap: int) -> int:
    """How often each of a frame's points is carried, over all frames and in both directions of time."""
    pairs = sum(2 * (frames - gap) for gap in range(1, min(frames - 1, max_gap) + 1))
    return pairs * gaps


def affordable_points(wanted: int, frames: int, gaps: int, max_gap: int, cost: float, seconds: float) -> int:
    """Points of each frame whose links take at most so many seconds, `wanted` at most.

    Raises `SupervisionError` where not even `MIN_POINTS` can be linked in that time, nor in `PATIENCE`.

    Args:
        wanted: points of each frame.
        frames: of the clip.
        gaps: flow's and matches' gaps, over which points are carried.
        max_gap: longest gap that is linked.
        cost: seconds of carrying a point over one gap.
        seconds: for linking.
    """
    each = cost * hops(frames, gaps, max_gap)
    if min(wanted, MIN_POINTS) * each > max(seconds, PATIENCE):
        raise SupervisionError(
            f"{frames} frames are too many for the time that there is: to link {MIN_POINTS} points a frame, the least, "
            f"takes about {MIN_POINTS * each / 60:.0f} minutes, and {seconds:.0f} seconds are left for it; give a "
            "longer --time-budget or --prepare-budget, or fit a part, CLIP@A:B"
        )
    return int(max(min(wanted, MIN_POINTS), min(wanted, seconds / each)))

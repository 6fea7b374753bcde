"""The schedule of intervals: at which frame gaps flow is computed, given what there is time for."""

from __future__ import annotations

from collections.abc import Callable

from decomotion.data.flow.config import FlowConfig


def choose_intervals(
    config: FlowConfig, frames: int, max_gap: int, affordable: Callable[[tuple[int, ...]], bool]
) -> tuple[int, ...]:
    """Gaps for direct flow, ascending, 1 among them.

    A list in the configuration stands as it is, whatever it costs. `all` takes every gap if that is affordable and
    else falls back to `geometric`: 1, 2, 4, … up to `longest_interval`, thinned by `thinned` until it is affordable.

    Args:
        config: which gaps are wanted.
        frames: frames of the clip; gaps that it does not have are left out.
        max_gap: longest gap that is linked at all.
        affordable: whether there is time for flow at these gaps.
    """
    longest = min(frames - 1, max_gap)
    if not isinstance(config.intervals, str):
        return tuple(sorted({gap for gap in config.intervals if gap <= longest}))
    if config.intervals == "all":
        every = tuple(range(1, longest + 1))
        if affordable(every):
            return every
    gaps = [1]
    while 2 * gaps[-1] <= min(longest, config.longest_interval):
        gaps.append(2 * gaps[-1])
    while len(gaps) > 1 and not affordable(tuple(gaps)):
        gaps = thinned(gaps)
    return tuple(gaps)


def thinned(gaps: list[int]) -> list[int]:
    """One gap fewer, the one that was missed least (docs/research/supervision.md, S8); 1 stays.

    1 2 4 8 16, then 1 4 8 16, 1 8 16, 1 8, 1; or 1 2 4 8, then 1 4 8, 1 4, 1.
    """
    return [gaps[0], *gaps[2:]] if len(gaps) > 3 else gaps[:-1]


def count_fields(gaps: tuple[int, ...], frames: int) -> int:
    """Fields that these gaps need, both ways."""
    return sum(2 * (frames - gap) for gap in gaps if gap < frames)


def couples_of(gap: int, frames: int) -> list[tuple[int, int]]:
    """The frames (first, second) that are `gap` apart, the earlier one first."""
    return [(first, first + gap) for first in range(frames - gap)]


def pairs_of(gaps: tuple[int, ...], frames: int) -> list[tuple[int, int]]:
    """The frame pairs (first, second) of these gaps, both ways, ordered by gap: neighbours first."""
    return [pair for gap in gaps for here, there in couples_of(gap, frames) for pair in ((here, there), (there, here))]

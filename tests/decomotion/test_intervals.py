"""The schedule of intervals: all that is wanted where it is affordable, else the ones that are missed least."""

from __future__ import annotations

import pytest

from decomotion.config import load
from decomotion.data.flow.config import FlowConfig
from decomotion.data.links.intervals import choose_intervals, count_fields, pairs_of


def flow(intervals: object = "geometric", longest: int = 16) -> FlowConfig:
    return load("cpu").data.flow.model_copy(update={"intervals": intervals, "longest_interval": longest})


def chosen(config: FlowConfig, frames: int, affordable: float, max_gap: int = 1000) -> tuple[int, ...]:
    """With a budget for so many fields."""
    return choose_intervals(config, frames, max_gap, lambda gaps: count_fields(gaps, frames) <= affordable)


def test_geometric_where_there_is_time():
    assert chosen(flow(), 32, 258) == (1, 2, 4, 8, 16)
    assert chosen(flow(longest=8), 32, 1000) == (1, 2, 4, 8)
    assert chosen(flow(), 32, 1000, max_gap=5) == (1, 2, 4)


@pytest.mark.parametrize("frames", [2, 3, 5, 9])
def test_no_gap_that_the_clip_has_not(frames: int):
    assert max(chosen(flow(), frames, 10_000)) <= frames - 1
    assert max(chosen(flow((1, 2, 4, 8)), frames, 10_000)) <= frames - 1


def test_thinned_to_what_is_affordable():
    wanted = [(1, 2, 4, 8, 16), (1, 4, 8, 16), (1, 8, 16), (1, 8), (1,)]
    for gaps in wanted:
        assert chosen(flow(), 90, count_fields(gaps, 90)) == gaps
    assert chosen(flow(), 90, 1) == (1,)  # without it there is nothing to link


def test_all_pairs_where_they_are_affordable():
    every = tuple(range(1, 10))
    assert chosen(flow("all"), 10, count_fields(every, 10)) == every
    assert chosen(flow("all"), 10, count_fields(every, 10) - 1) == (1, 2, 4, 8)


def test_a_list_stands_whatever_it_costs():
    assert chosen(flow((3, 1)), 20, 1) == (1, 3)


@pytest.mark.parametrize("frames", [2, 7, 20])
def test_pairs_are_those_of_the_gaps_neighbours_first(frames: int):
    gaps = (1, 2, 4)
    pairs = pairs_of(gaps, frames)
    expected = {(i, j) for i in range(frames) for j in range(frames) if abs(i - j) in gaps}
    assert set(pairs) == expected
    assert len(pairs) == len(expected) == count_fields(gaps, frames)
    distances = [abs(i - j) for i, j in pairs]
    assert distances == sorted(distances)

"""What linking costs: counted hop by hop, measured on a piece of the clip, and shared out."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from decomotion.clip import Clip
from decomotion.data.links import costs, linking
from decomotion.data.links.costs import HopCosts, affordable_points, hop_costs, hops, later_costs
from decomotion.data.links.refinement import Refiner
from tiny_fit import FRAMES, HEIGHT, WIDTH, sliding_square


@pytest.mark.parametrize(("frames", "gaps", "max_gap"), [(2, (1,), 9), (7, (1, 3), 9), (7, (1, 2), 3), (9, (4, 8), 9)])
def test_hops_are_those_of_linking(
    frames: int, gaps: tuple[int, ...], max_gap: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 5 points of each frame, linked both ways; linking asks for gap 1, too, where it is not among them."""
    carried, hop = [], linking._hop

    def counted(best: linking._State, start: linking._State, *arguments: object) -> None:
        gap = arguments[2]
        if gap in gaps:
            carried.append(start.variance.size)
        hop(best, start, *arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(linking, "_hop", counted)
    points, still = np.full((frames, 5, 2), 3, np.float32), np.zeros((6, 8, 2), np.float32)
    for step in (1, -1):
        for _ in linking.link(points, lambda *_: still, tuple({1, *gaps}), 1.0, max_gap, step):
            pass
    assert sum(carried) == 5 * hops(frames, gaps, max_gap)


def test_flow_and_matches_have_their_own_costs() -> None:
    """3 frames: over a gap of 1, two pairs of neighbours and one that is two apart, both ways; over a gap of 2, one."""
    assert HopCosts(flow=1.0, match=10.0).of_a_point(3, (1, 2), (2,), 1000) == 6 + 2 + 20


def test_points_are_thinned_to_the_time() -> None:
    assert affordable_points(1000, each=0.1, seconds=101.0) == 1000
    assert affordable_points(1000, each=0.1, seconds=50.05) == 500
    assert affordable_points(1000, each=0.1, seconds=-5.0) == 256
    assert affordable_points(100, each=0.1, seconds=1.0) == 100  # where no more are wanted


def test_what_follows_costs_something_in_any_case_and_something_for_each_point() -> None:
    later = later_costs(lambda points: 3 + 0.01 * points, 1000)
    assert (later.fixed, later.each) == pytest.approx((3, 0.01))
    assert later.of(500) == pytest.approx(8)
    few = later_costs(lambda points: 3 + 0.01 * points, 100)
    assert (few.fixed, few.each) == (4, 0)
    dearer_at_first = later_costs(lambda points: 5 - 0.001 * points, 1000)
    assert (dearer_at_first.fixed, dearer_at_first.each) == (pytest.approx(4.744), 0)


@pytest.mark.parametrize("points", [100, 10**6])
def test_the_cost_is_that_of_one_hop_of_one_point(points: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """6 frames linked by flow in 3 seconds, and by matches, too, in 7; so many points as the clip has, or a block."""
    linked, seconds = [], iter([3.0, 7.0])

    def least_seconds(task: Callable[[], object]) -> float:
        task()
        return next(seconds)

    def link(where: np.ndarray, *_: object) -> tuple[()]:
        linked.append(where.shape)
        return ()

    monkeypatch.setattr(costs, "least_seconds", least_seconds)
    monkeypatch.setattr(costs, "link", link)
    cost = hop_costs(sliding_square(), (WIDTH, HEIGHT), points)
    block = min(points * FRAMES, 250_000) // 6
    assert set(linked) == {(6, block, 2)}
    assert cost.flow == pytest.approx(3 / (block * (30 + 20)))  # gaps 1 and 2
    assert cost.match == pytest.approx(4 / (block * (20 + 12)))  # gaps 2 and 3


def test_a_trial_loses_points_and_finds_some_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """In clips of several hundred frames three of a hundred hops by matches are registered."""
    registered, carried = [], []
    refine, find = Refiner.__call__, linking._find_again

    def counted(self: Refiner, first: int, second: int, xy: np.ndarray, *rest: object) -> np.ndarray:
        registered.append(len(xy))
        return refine(self, first, second, xy, *rest)  # type: ignore[arg-type]

    def counted_hops(best: linking._State, starts: list[tuple[int, linking._State]], *rest: object) -> None:
        carried.extend(start.variance.size for _, start in starts)
        find(best, starts, *rest)  # type: ignore[arg-type]

    monkeypatch.setattr(Refiner, "__call__", counted)
    monkeypatch.setattr(linking, "_find_again", counted_hops)
    hop_costs(sliding_square(), (WIDTH, HEIGHT), 400)
    assert 0.01 < sum(registered) / sum(carried) < 0.06


@pytest.mark.parametrize("frames", [2, 3])
def test_of_clips_of_few_frames(frames: int) -> None:
    clip = Clip("few", np.zeros((frames, 5, 3, 3), np.uint8))
    cost = hop_costs(clip, (3, 5), 16)
    assert cost.flow > 0
    assert cost.match >= 0

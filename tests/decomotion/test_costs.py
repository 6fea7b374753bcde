"""What linking costs: counted hop by hop, and shared out."""

from __future__ import annotations

import numpy as np
import pytest

from decomotion.data.links import costs
from decomotion.data.links.costs import affordable_points, hops, seconds_per_hop
from decomotion.errors import SupervisionError


@pytest.mark.parametrize(("frames", "max_gap"), [(2, 1000), (7, 1000), (7, 3), (30, 4)])
def test_hops_are_those_of_all_linked_pairs(frames: int, max_gap: int):
    pairs = sum(0 < abs(i - j) <= max_gap for i in range(frames) for j in range(frames))
    assert hops(frames, 5, max_gap) == 5 * pairs


def test_points_are_thinned_to_the_time():
    """9 frames, 2 gaps: 144 hops a point; a thousandth of a second each, 144 seconds for 1,000 points."""
    wanted = {"frames": 9, "gaps": 2, "max_gap": 1000, "cost": 1e-3}
    assert affordable_points(1000, seconds=145.0, **wanted) == 1000
    assert affordable_points(1000, seconds=72.1, **wanted) == 500
    assert affordable_points(1000, seconds=43.3, **wanted) == 300


def test_few_points_are_linked_within_a_minute_and_refused_beyond():
    """The least is 256 points: 37 seconds of such hops in 9 frames, 7 minutes in 30."""
    wanted = {"gaps": 2, "max_gap": 1000, "cost": 1e-3}
    assert affordable_points(1000, frames=9, seconds=1.0, **wanted) == 256
    assert affordable_points(100, frames=9, seconds=1.0, **wanted) == 100  # where no more are wanted
    sentence = "30 frames are too many for the time that there is: .* 256 points .* 7 minutes, and 45 seconds are left"
    with pytest.raises(SupervisionError, match=sentence):
        affordable_points(1000, frames=30, seconds=45.0, **wanted)


def test_the_cost_is_measured_and_that_of_one_hop_of_one_point(monkeypatch: pytest.MonkeyPatch):
    """A trial of 12 frames, 3 gaps and 2,048 points that takes 2 seconds, and one that takes 3."""
    ticks = iter([0.0, 2.0, 10.0, 13.0])
    monkeypatch.setattr(costs.time, "perf_counter", lambda: next(ticks))
    assert seconds_per_hop(36, 48) == pytest.approx(2 / (2048 * 3 * 12 * 11))
    monkeypatch.undo()
    assert 0 < seconds_per_hop(36, 48) < 1e-4
    assert np.isfinite(seconds_per_hop(5, 3))

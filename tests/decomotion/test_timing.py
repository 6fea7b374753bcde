"""Timing: the least of some trials."""

from __future__ import annotations

import pytest

from decomotion.data import timing


@pytest.mark.parametrize(
    ("lasting", "least"),
    [
        ([3.0, 2.0, 1.0], 2.0),  # dear: two trials
        ([0.125, 0.0625, 0.0625, 0.25, 0.03], 0.0625),  # cheap: until a third of a second has gone by
        ([0.0625, 0.125, 0.03125, 0.125, 0.01], 0.03125),
    ],
)
def test_the_least_of_some_trials(lasting: list[float], least: float, monkeypatch: pytest.MonkeyPatch) -> None:
    now, left = [0.0], iter(lasting)

    def task() -> None:
        now[0] += next(left)

    monkeypatch.setattr(timing, "SECONDS", 0.3)
    monkeypatch.setattr(timing.time, "perf_counter", lambda: now[0])
    assert timing.least_seconds(task) == least

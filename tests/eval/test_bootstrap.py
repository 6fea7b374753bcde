"""The interval of a mean over videos."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from decomo_eval.bootstrap import mean_interval


def test_it_is_that_of_the_normal_distribution_where_that_holds() -> None:
    values = np.random.default_rng(0).normal(0.6, 0.1, 400)
    low, high = mean_interval(values)
    half = 1.96 * values.std() / 20
    assert (low, high) == pytest.approx((values.mean() - half, values.mean() + half), abs=0.1 * half)


@settings(deadline=None, max_examples=25)
@given(st.lists(st.floats(0, 1), min_size=2, max_size=12), st.randoms())
def test_it_holds_the_mean_and_stays_within_the_values(values: list[float], random) -> None:
    low, high = mean_interval(values)
    rounding = 1e-12
    assert min(values) - rounding <= low <= np.mean(values) + rounding
    assert np.mean(values) - rounding <= high <= max(values) + rounding
    random.shuffle(values)
    assert mean_interval([*values, math.nan]) == (low, high)


def test_one_video_has_none() -> None:
    assert all(math.isnan(end) for end in mean_interval([0.5, math.nan]))


def test_another_seed_draws_other_videos() -> None:
    values = np.random.default_rng(0).normal(0.6, 0.1, 20)
    intervals = [mean_interval(values, seed=seed) for seed in (0, 0, 1)]
    assert intervals[0] == intervals[1] != intervals[2]
    assert intervals[0] == pytest.approx(intervals[2], abs=0.005)

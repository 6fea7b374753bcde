"""Derivatives along time: exact on polynomials at any times, and as certain as they say."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from decomo_runtime import MeasureError, Smoothing
from decomo_runtime.measure.smoothing import derivatives

SEEN = np.zeros((1, 20), bool)


@given(st.integers(0, 2**31), st.sampled_from([(3, 2), (7, 2), (9, 4)]))
def test_polynomials_are_exact_up_to_the_ends(seed: int, smoothing: tuple[int, int]):
    rng = np.random.default_rng(seed)
    times = 5 + np.cumsum(rng.uniform(0.005, 0.05, 20))
    polynomials = [np.polynomial.Polynomial(rng.normal(size=3)) for _ in range(2)]
    places = np.stack([each(times) for each in polynomials], axis=-1)[None]
    found = derivatives(places, times, SEEN, Smoothing(*smoothing))
    for order, values in ((1, found.velocity), (2, found.acceleration)):
        truth = np.stack([each.deriv(order)(times) for each in polynomials], axis=-1)
        np.testing.assert_allclose(values[0], truth, rtol=1e-6, atol=1e-6 * np.abs(truth).max())


def test_steady_times_give_savitzky_and_golay_s_weights():
    """Their table for five points and order two: (-2, -1, 0, 1, 2) / 10 and (2, -1, -2, -1, 2) / 7."""
    impulses = np.eye(5)[:, :, None] * [1, 0]
    found = derivatives(impulses, np.arange(5) / 2, np.zeros((5, 5), bool), Smoothing(5, 2))
    np.testing.assert_allclose(found.velocity[:, 2, 0], np.array([-2, -1, 0, 1, 2]) / 10 * 2, atol=1e-12)
    np.testing.assert_allclose(found.acceleration[:, 2, 0], np.array([2, -1, -2, -1, 2]) / 7 * 4, atol=1e-12)
    np.testing.assert_allclose(found.gain[:, 2], 2 / np.sqrt(10))


def test_the_ends_are_less_certain_and_say_so():
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((4000, 20, 2))
    found = derivatives(noise, np.arange(20) / 240, np.broadcast_to(SEEN, (4000, 20)), Smoothing())
    np.testing.assert_allclose(found.velocity.std((0, 2)), found.gain[0], rtol=0.05)
    assert found.gain[0, 0] > 3 * found.gain[0, 10]
    np.testing.assert_allclose(found.gain[0], found.gain[0, ::-1])


def test_what_is_hidden_does_not_touch_what_is_in_sight():
    times = np.arange(20) / 10
    places = np.stack([3 * times, -times], axis=-1)[None]
    hidden = SEEN.copy()
    hidden[0, [4, 5, 12]] = True
    wrong = np.where(hidden[..., None], places + 9, places)
    found = derivatives(wrong, times, hidden, Smoothing())
    np.testing.assert_allclose(found.velocity[~hidden], np.broadcast_to([3, -1], (17, 2)))
    assert (np.abs(found.velocity[hidden] - [3, -1]) > 1).any()
    assert found.used[0, 5] == 7
    assert found.used[0, 6] == 5


def test_too_few_in_sight_are_nothing():
    hidden = ~SEEN
    hidden[0, [0, 1]] = False
    found = derivatives(np.zeros((1, 20, 2)), np.arange(20.0), hidden, Smoothing())
    assert np.isnan(found.velocity[0, :2]).all()
    assert np.isnan(found.gain[0, :2]).all()
    assert np.isfinite(found.velocity[0, 2:]).all()
    assert found.used[0, 0] == 2


def test_windows_that_do_not_fit():
    with pytest.raises(MeasureError, match="needs 21 frames but there are 20"):
        derivatives(np.zeros((1, 20, 2)), np.arange(20.0), SEEN, Smoothing(21, 2))


@pytest.mark.parametrize("text", ["6,2", "7,1", "7,7", "7", "a,b", "7,2,1", "-7,2", ""])
def test_bad_smoothing(text: str):
    with pytest.raises(MeasureError, match="--smooth"):
        Smoothing.parse(text)


def test_smoothing_is_read():
    assert Smoothing.parse("9,3") == Smoothing(9, 3)

"""How numbers change over a run, by hand."""

from __future__ import annotations

import pytest

from decomotion.config import load
from decomotion.schedule import Budget, OptimConfig, Schedule, learning_rate_factor, longest_gap, value_at


def optim(**changes: object) -> OptimConfig:
    return load("cpu").optim.model_copy(update=changes)


@pytest.mark.parametrize(
    ("progress", "expected"), [(0.0, 1.0), (0.2, 1.0), (0.3, 0.75), (0.4, 0.5), (0.5, 0.25), (0.6, 0.0), (1.0, 0.0)]
)
def test_a_schedule_is_linear_between_two_points(progress: float, expected: float):
    assert value_at(Schedule(value=1, to=0, begin=0.2, end=0.6), progress) == pytest.approx(expected)


def test_a_number_stays():
    assert [value_at(0.7, progress) for progress in (0.0, 0.5, 1.0)] == [0.7] * 3


def test_a_schedule_of_no_length_is_a_switch():
    switch = Schedule(value=0, to=5, begin=0.5, end=0.5)
    assert [value_at(switch, progress) for progress in (0.49, 0.5, 0.51)] == [0, 5, 5]


@pytest.mark.parametrize(("progress", "expected"), [(0.05, 0.5), (0.1, 1.0), (0.325, 0.85355), (0.55, 0.5), (1.0, 0.0)])
def test_warm_up_then_half_a_cosine(progress: float, expected: float):
    assert learning_rate_factor(optim(warmup=0.1, decay="cosine"), progress) == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize(("progress", "expected"), [(0.01, 0.5), (0.1, 1), (0.3, 0.5), (0.5, 0.25), (0.99, 0.0625)])
def test_warm_up_then_steps(progress: float, expected: float):
    config = optim(warmup=0.02, decay="step", decay_every=0.2, decay_factor=0.5)
    assert learning_rate_factor(config, progress) == pytest.approx(expected)


def test_the_first_step_moves():
    assert learning_rate_factor(optim(warmup=0.1), 0.0) > 0


def test_no_warm_up():
    assert learning_rate_factor(optim(warmup=0.0, decay="cosine"), 0.0) == 1


@pytest.mark.parametrize(("progress", "expected"), [(0.0, 2), (0.2, 11), (0.4, 20), (1.0, 20)])
def test_the_longest_gap_grows(progress: float, expected: int):
    config = optim(gap=Schedule(value=0.1, to=1, begin=0, end=0.4))
    assert longest_gap(config, progress, num_frames=21) == expected


def test_the_longest_gap_is_at_least_one_frame_and_within_the_clip():
    config = optim(gap=Schedule(value=0, to=1, begin=0, end=0.4))
    assert longest_gap(config, 0.0, num_frames=50) == 1
    assert longest_gap(config, 1.0, num_frames=2) == 1


def test_progress_in_steps_and_in_time_without_preparation():
    assert Budget(steps=8).progress(2, 99.0, 9.0) == 0.25
    ten_minutes = Budget(steps=8, seconds=600.0)
    assert ten_minutes.progress(0, 100.0, 100.0) == 0
    assert ten_minutes.progress(5, 350.0, 100.0) == 0.5
    assert ten_minutes.progress(5, 700.0, 100.0) == 1


def test_a_budget_used_up_by_preparation_still_leaves_a_moment():
    assert Budget(steps=8, seconds=5.0).progress(0, 7.0, 7.0) == 0
    assert Budget(steps=8, seconds=5.0).progress(9, 8.0, 7.0) == 1

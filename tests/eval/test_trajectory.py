"""Survival and median trajectory error: numbers worked on paper, and properties."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from decomo_eval.metrics import tapvid_metrics, temporal_coherence
from decomo_eval.trajectory import median_trajectory_error, survival


def example(distance: list[list[float]], hidden: list[list[int]], query_frames: list[int]) -> dict[str, Any]:
    """One video whose predictions lie `distance` pixels beside the truth."""
    true = np.full((1, *np.shape(distance), 2), 100.0)
    return {
        "query_points": np.array([[[frame, 100.0, 100.0] for frame in query_frames]]),
        "gt_occluded": np.array([hidden], dtype=bool),
        "gt_tracks": true,
        "pred_tracks": true + np.array(distance)[None, :, :, None] * [0.6, 0.8],
    }


def test_survival_ends_at_the_first_failure_and_runs_both_ways() -> None:
    # Fails in frame 1, comes back in 0: lost in both. Later frames are of the other direction. 50 is no failure yet.
    track = example([[0, 51, 0, 50, 60, 0]], [[0] * 6], [2])
    assert survival(**track, query_mode="strided")[0] == pytest.approx(1 / 5)
    assert survival(**track, query_mode="first")[0] == pytest.approx(1 / 3)


def test_hidden_points_do_not_fail_and_tracks_weigh_the_same() -> None:
    tracks = example([[0, 99, 1, 1, 1], [0, 0, 0, 0, 99]], [[0, 1, 0, 0, 0], [0] * 5], [0, 3])
    assert survival(**tracks, query_mode="first")[0] == pytest.approx((1 + 0) / 2)
    assert survival(**tracks, query_mode="strided")[0] == pytest.approx((1 + 3 / 4) / 2)


def test_median_error_on_paper() -> None:
    tracks = example([[9, 1, 2, 6], [0, 4, 8, 99]], [[0] * 4, [0, 0, 0, 1]], [0, 0])
    assert median_trajectory_error(**tracks, query_mode="first")[0] == pytest.approx((2 + 6) / 2)


def test_medians_equal_numpy_s() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        arrays = random_arrays(rng)
        counted = ~arrays["gt_occluded"] & (
            np.arange(arrays["gt_occluded"].shape[2]) != arrays["query_points"][..., :1]
        )
        distance = np.linalg.norm(arrays["pred_tracks"] - arrays["gt_tracks"], axis=-1)
        del arrays["pred_occluded"]
        for video, value in enumerate(median_trajectory_error(**arrays, query_mode="strided")):
            rows = zip(distance[video], counted[video], strict=True)
            medians = [np.median(row[which]) for row, which in rows if which.any()]
            assert value == pytest.approx(np.mean(medians) if medians else math.nan, rel=1e-12, nan_ok=True)


def test_nothing_to_count_is_nan_and_a_lost_prediction_is_the_worst() -> None:
    last = example([[0, 0, 0]], [[0] * 3], [2])
    assert math.isnan(survival(**last, query_mode="first")[0])
    assert math.isnan(median_trajectory_error(**last, query_mode="first")[0])
    last["pred_tracks"][:] = np.nan
    assert survival(**last, query_mode="strided")[0] == 0
    assert median_trajectory_error(**last, query_mode="strided")[0] == math.inf


seeds = st.integers(0, 2**32 - 1)
modes = st.sampled_from(["first", "strided"])


def all_metrics(arrays: dict[str, Any], query_mode: str) -> dict[str, np.ndarray]:
    truth = {key: arrays[key] for key in ("query_points", "gt_occluded", "gt_tracks", "pred_tracks")}
    return {
        **tapvid_metrics(**arrays, query_mode=query_mode),
        "temporal_coherence": temporal_coherence(arrays["gt_occluded"], arrays["gt_tracks"], arrays["pred_tracks"]),
        "survival": survival(**truth, query_mode=query_mode),
        "median_trajectory_error": median_trajectory_error(**truth, query_mode=query_mode),
    }


def random_arrays(rng: np.random.Generator) -> dict[str, Any]:
    b, n, t = rng.integers(1, 3), rng.integers(1, 6), rng.integers(1, 9)
    true = rng.uniform(0, 256, (b, n, t, 2))
    return {
        "query_points": np.stack([rng.integers(0, t, (b, n)), *np.zeros((2, b, n))], axis=-1),
        "gt_occluded": rng.random((b, n, t)) < rng.choice([0.1, 0.5, 0.95]),
        "gt_tracks": true,
        "pred_occluded": rng.random((b, n, t)) < 0.4,
        "pred_tracks": true + rng.normal(0, 1, true.shape) * rng.choice([1, 20, 80], (b, n, t, 1)),
    }


def assert_same(first: dict[str, np.ndarray], second: dict[str, np.ndarray]) -> None:
    for name, value in first.items():
        # sums in another order round differently
        np.testing.assert_allclose(value, second[name], rtol=1e-12, atol=1e-12, err_msg=name)


@settings(deadline=None, max_examples=30)
@given(seed=seeds, query_mode=modes)
def test_the_order_of_tracks_does_not_matter(seed: int, query_mode: str) -> None:
    rng = np.random.default_rng(seed)
    arrays = random_arrays(rng)
    order = rng.permutation(arrays["query_points"].shape[1])
    shuffled = {key: value[:, order] for key, value in arrays.items()}
    assert_same(all_metrics(arrays, query_mode), all_metrics(shuffled, query_mode))


@settings(deadline=None, max_examples=30)
@given(seed=seeds, query_mode=modes)
def test_where_hidden_points_are_does_not_matter(seed: int, query_mode: str) -> None:
    rng = np.random.default_rng(seed)
    arrays = random_arrays(rng)
    moved = {**arrays, "gt_tracks": arrays["gt_tracks"].copy(), "pred_tracks": arrays["pred_tracks"].copy()}
    for key in ("gt_tracks", "pred_tracks"):
        moved[key][arrays["gt_occluded"]] = rng.uniform(-1e3, 1e3, 2)
    assert_same(all_metrics(arrays, query_mode), all_metrics(moved, query_mode))


@settings(deadline=None, max_examples=30)
@given(seed=seeds, query_mode=modes, length=st.integers(1, 5))
def test_padding_with_hidden_frames_changes_no_position_score(seed: int, query_mode: str, length: int) -> None:
    arrays = random_arrays(np.random.default_rng(seed))
    padded = {"query_points": arrays["query_points"]}
    for key, value in arrays.items():
        if key != "query_points":
            filler = np.ones if value.dtype == bool else np.zeros
            padded[key] = np.concatenate([value, filler((*value.shape[:2], length, *value.shape[3:]), value.dtype)], 2)
    before, after = all_metrics(arrays, query_mode), all_metrics(padded, query_mode)
    changes = {"occlusion_accuracy", "survival"}  # shares of all counted frames, hidden ones too
    assert_same({name: value for name, value in before.items() if name not in changes}, after)


@pytest.mark.parametrize("off", [0.4, -0.4])
def test_a_query_s_frame_is_the_nearest_one(off: float) -> None:
    track = example([[0, 51, 0, 50, 60, 0]], [[0] * 6], [2])
    track["query_points"][..., 0] += off
    assert survival(**track, query_mode="strided")[0] == pytest.approx(1 / 5)
    assert survival(**track, query_mode="first")[0] == pytest.approx(1 / 3)


def test_nothing_fails_in_the_query_s_frame() -> None:
    """Which does not count, wherever a tracker says that the query is."""
    track = example([[0, 0, 99, 0, 0, 0]], [[0] * 6], [2])
    assert survival(**track, query_mode="strided")[0] == survival(**track, query_mode="first")[0] == 1

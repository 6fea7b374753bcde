"""Metrics against numbers worked on paper, against a slow twin of nested loops, and by their properties."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import decomo_eval
from decomo_eval.errors import EvalError
from decomo_eval.metrics import THRESHOLDS, reappeared, tapvid_metrics, temporal_coherence

NAMES = [
    "occlusion_accuracy",
    *(f"{kind}_{threshold}" for threshold in THRESHOLDS for kind in ("pts_within", "jaccard")),
    "average_jaccard",
    "average_pts_within_thresh",
]


def paper_example() -> dict[str, np.ndarray]:
    """Three points over four frames; v visible, o occluded, ? a frame of the query, which must not count.

        query frame   true      predicted   distance where visible
    A   0             v v v v   ? v v v     ? 0 3 20
    B   1             o v v o   v ? v v     - ? 1 -
    C   0             v v o o   ? o o o     ? 0 - -
    """
    true_occluded = [[0, 0, 0, 0], [1, 0, 0, 1], [0, 0, 1, 1]]
    predicted_occluded = [[1, 0, 0, 0], [0, 1, 0, 0], [1, 1, 1, 1]]
    distance = np.array([[99, 0, 3, 20], [0, 99, 1, 0], [99, 0, 0, 0]], dtype=float)
    true = np.full((1, 3, 4, 2), 100.0)
    return {
        "query_points": np.array([[[0, 100, 100], [1, 100, 100], [0, 100, 100]]], dtype=float),
        "gt_occluded": np.array([true_occluded], dtype=bool),
        "gt_tracks": true,
        "pred_occluded": np.array([predicted_occluded], dtype=bool),
        "pred_tracks": true + distance[None, :, :, None] * [0, -1],
    }


def test_first_mode_on_paper() -> None:
    metrics = tapvid_metrics(**paper_example(), query_mode="first")
    # Frames after the query's: A 1 2 3, B 2 3, C 1 2 3, eight in all. Occlusion is wrong in B 3 and C 1.
    assert metrics["occlusion_accuracy"] == 6 / 8
    # Truly visible among them: A 1 2 3, B 2, C 1, five in all, at distances 0 3 20, 1, 0; 1 is not within 1.
    within = {1: 2 / 5, 2: 3 / 5, 4: 4 / 5, 8: 4 / 5, 16: 4 / 5}
    # C 1 is predicted occluded and cannot be a true positive. Predicted visible: A 1 2 3, B 2 3, of which true
    # positives at 1: A 1; at 2: also B 2; at 4 and more: also A 2. The rest are false positives: 4, 3, 2, 2, 2.
    jaccard = {1: 1 / (5 + 4), 2: 2 / (5 + 3), 4: 3 / (5 + 2), 8: 3 / (5 + 2), 16: 3 / (5 + 2)}
    for threshold in THRESHOLDS:
        assert metrics[f"pts_within_{threshold}"] == within[threshold]
        assert metrics[f"jaccard_{threshold}"] == jaccard[threshold]
    # Sums of five fractions in another order than here: equal but for rounding.
    assert metrics["average_pts_within_thresh"] == pytest.approx(17 / 25, rel=1e-15)
    assert metrics["average_jaccard"] == pytest.approx((1 / 9 + 1 / 4 + 3 * 3 / 7) / 5, rel=1e-15)


def test_strided_mode_on_paper() -> None:
    metrics = tapvid_metrics(**paper_example(), query_mode="strided")
    # One frame more than in first mode: B 0, truly occluded, predicted visible: wrong, and a false positive.
    assert metrics["occlusion_accuracy"] == 6 / 9
    assert metrics["average_pts_within_thresh"] == pytest.approx(17 / 25, rel=1e-15)  # rounding, as above
    assert metrics["average_jaccard"] == pytest.approx((1 / 10 + 2 / 9 + 3 * 3 / 8) / 5, rel=1e-15)


def test_videos_of_a_batch_are_scored_one_by_one() -> None:
    good = paper_example()
    perfect = {**good, "pred_occluded": good["gt_occluded"], "pred_tracks": good["gt_tracks"]}
    batch = {key: np.concatenate([good[key], perfect[key]]) for key in good}
    metrics = tapvid_metrics(**batch, query_mode="first")
    assert list(metrics) == NAMES
    for name, value in metrics.items():
        assert value.shape == (2,)
        assert value[0] == tapvid_metrics(**good, query_mode="first")[name][0]
        assert value[1] == 1


@pytest.mark.parametrize("query_mode", ["first", "strided"])
def test_a_video_without_visible_point_has_no_position_score(query_mode: str) -> None:
    example = paper_example()
    example["gt_occluded"] = np.ones((1, 3, 4), dtype=bool)
    example["pred_occluded"] = np.ones((1, 3, 4), dtype=bool)
    metrics = tapvid_metrics(**example, query_mode=query_mode)
    assert metrics["occlusion_accuracy"] == 1
    assert all(math.isnan(metrics[name][0]) for name in NAMES if name != "occlusion_accuracy")
    # One false positive, and there is something to count for Jaccard: it is 0. Still nothing for position.
    example["pred_occluded"][0, 0, 3] = False
    metrics = tapvid_metrics(**example, query_mode=query_mode)
    assert metrics["average_jaccard"] == 0
    assert math.isnan(metrics["average_pts_within_thresh"][0])


def test_no_queries_and_no_counted_frame_give_nan() -> None:
    empty = {key: value[:, :0] for key, value in paper_example().items()}
    assert all(np.isnan(value).all() for value in tapvid_metrics(**empty, query_mode="strided").values())
    last = paper_example()
    last["query_points"][..., 0] = 3
    assert math.isnan(tapvid_metrics(**last, query_mode="first")["occlusion_accuracy"][0])


def test_a_nan_prediction_is_a_miss() -> None:
    example = paper_example()
    example["pred_tracks"] = np.full_like(example["gt_tracks"], np.nan)
    metrics = tapvid_metrics(**example, query_mode="first")
    assert metrics["average_pts_within_thresh"] == 0
    assert metrics["average_jaccard"] == 0


def slow_twin(
    query_points: np.ndarray,
    gt_occluded: np.ndarray,
    gt_tracks: np.ndarray,
    pred_occluded: np.ndarray,
    pred_tracks: np.ndarray,
    query_mode: str,
) -> dict[str, list[float]]:
    """The definitions read aloud, one point at a time."""
    metrics: dict[str, list[float]] = {name: [] for name in NAMES}
    for video in range(len(query_points)):
        points = []
        for query, (t, _, _) in enumerate(query_points[video]):
            for frame in range(gt_tracks.shape[2]):
                if frame > t if query_mode == "first" else frame != t:
                    dx, dy = pred_tracks[video, query, frame] - gt_tracks[video, query, frame]
                    seen = not gt_occluded[video, query, frame]
                    said = not pred_occluded[video, query, frame]
                    points.append((seen, said, math.hypot(dx, dy)))
        metrics["occlusion_accuracy"].append(fraction([seen == said for seen, said, _ in points]))
        for threshold in THRESHOLDS:
            within = [distance < threshold for seen, _, distance in points if seen]
            metrics[f"pts_within_{threshold}"].append(fraction(within))
            jaccard = []
            for seen, said, distance in points:
                if seen and said and distance < threshold:
                    jaccard.append(True)
                elif seen and said:
                    jaccard += [False, False]  # the true point is missed, and the predicted one is wrong
                elif seen or said:
                    jaccard.append(False)
            metrics[f"jaccard_{threshold}"].append(fraction(jaccard))
        for kind, average in (("jaccard", "average_jaccard"), ("pts_within", "average_pts_within_thresh")):
            metrics[average].append(sum(metrics[f"{kind}_{threshold}"][-1] for threshold in THRESHOLDS) / 5)
    return metrics


def fraction(answers: list[bool]) -> float:
    return sum(answers) / len(answers) if answers else math.nan


def random_example(rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Distances are eighths of pixels, exact in binary, so that many of them fall upon a threshold."""
    b, n, t = rng.integers(1, 4), rng.integers(0, 5), rng.integers(1, 7)
    true = rng.integers(0, 256, (b, n, t, 2)).astype(float)
    return {
        "query_points": np.stack([rng.integers(0, t, (b, n)), *np.zeros((2, b, n))], axis=-1),
        "gt_occluded": rng.random((b, n, t)) < rng.choice([0.1, 0.5, 0.95]),
        "gt_tracks": true,
        "pred_occluded": rng.random((b, n, t)) < 0.4,
        "pred_tracks": true + rng.choice([0, 0, 0.125, 1, 2, 3, -4, 8, 16], true.shape),
    }


@pytest.mark.parametrize("query_mode", ["first", "strided"])
def test_metrics_equal_the_slow_twin(query_mode: str) -> None:
    rng = np.random.default_rng(0)
    for _ in range(60):
        example = random_example(rng)
        expected = slow_twin(**example, query_mode=query_mode)
        for name, value in tapvid_metrics(**example, query_mode=query_mode).items():
            # Only the averages over thresholds round differently.
            np.testing.assert_allclose(value, expected[name], rtol=1e-14, err_msg=name)


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 2**32 - 1), query_mode=st.sampled_from(["first", "strided"]))
def test_scores_keep_their_order_and_range(seed: int, query_mode: str) -> None:
    rng = np.random.default_rng(seed)
    example = random_example(rng)
    metrics = tapvid_metrics(**example, query_mode=query_mode)
    for value in metrics.values():
        defined = value[~np.isnan(value)]
        assert np.all((defined >= 0) & (defined <= 1))
    for tight, loose in pairwise(THRESHOLDS):
        for kind in ("pts_within", "jaccard"):
            assert not np.any(metrics[f"{kind}_{tight}"] > metrics[f"{kind}_{loose}"])
    order = rng.permutation(example["query_points"].shape[1])
    shuffled = tapvid_metrics(**{key: value[:, order] for key, value in example.items()}, query_mode=query_mode)
    for name, value in metrics.items():
        np.testing.assert_array_equal(value, shuffled[name])


def test_temporal_coherence_on_paper() -> None:
    # The truth moves evenly, so its second difference is 0. The prediction's error is 0, 1, 1, 4 times (0.6, 0.8):
    # second differences -1 and 3 times a unit vector.
    true = np.stack([np.arange(4.0), np.full(4, 7.0)], axis=-1)[None, None]
    predicted = true + np.array([0, 1, 1, 4])[:, None] * [0.6, 0.8]
    nowhere = np.zeros((1, 1, 4), dtype=bool)
    # 0.6 and 0.8 are not exact in binary.
    assert temporal_coherence(nowhere, true, predicted)[0] == pytest.approx((1 + 3) / 2, rel=1e-14)
    last = np.array([[[False, False, False, True]]])
    assert temporal_coherence(last, true, predicted)[0] == pytest.approx(1, rel=1e-14)


def test_temporal_coherence_pools_the_triplets_of_a_video() -> None:
    # Video 0: one point with two triplets of error 0 and one with a single triplet of error 6: (0 + 0 + 6) / 3.
    true = np.zeros((2, 2, 4, 2))
    predicted = true.copy()
    predicted[0, 1, 1, 0] = 3
    occluded = np.zeros((2, 2, 4), dtype=bool)
    occluded[0, 1, 3] = True
    occluded[1, :, 1] = True  # video 1: no three visible frames in a row
    coherence = temporal_coherence(occluded, true, predicted)
    assert coherence[0] == 2
    assert math.isnan(coherence[1])


def test_temporal_coherence_ignores_constant_velocity_errors_and_hidden_positions() -> None:
    rng = np.random.default_rng(0)
    true = rng.normal(size=(1, 3, 6, 2))
    occluded = np.zeros((1, 3, 6), dtype=bool)
    occluded[0, 0, 5] = True
    drift = np.arange(6)[:, None] * [2.0, -1.0] + 5
    hidden = true.copy()
    hidden[0, 0, 5] = np.nan
    # Adding and taking away the drift rounds at 1e-15 of it.
    assert temporal_coherence(occluded, hidden, true + drift)[0] == pytest.approx(0, abs=1e-13)


@pytest.mark.parametrize("frames", [1, 2])
def test_temporal_coherence_needs_three_frames(frames: int) -> None:
    tracks = np.zeros((1, 2, frames, 2))
    assert np.isnan(temporal_coherence(np.zeros((1, 2, frames), dtype=bool), tracks, tracks)).all()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"query_mode": "all"}, "strided, first"),
        ({"pred_tracks": np.zeros((1, 3, 5, 2))}, "pred_tracks must be"),
        ({"pred_tracks": np.zeros((1, 3, 5, 2)), "pred_occluded": np.zeros((1, 3, 5))}, "one shape"),
        ({"query_points": np.zeros((3, 3))}, "query_points must be"),
        ({"query_points": np.full((1, 3, 3), 100.0)}, "query frames must lie in 0..3"),
        ({"query_points": np.full((1, 3, 3), 4.0)}, "query frames must lie in 0..3"),
        ({"query_points": np.full((1, 3, 3), -1.0)}, "query frames must lie in 0..3"),
    ],
)
def test_wrong_arguments_are_named(change: dict[str, Any], words: str) -> None:
    arguments: dict[str, Any] = {**paper_example(), "query_mode": "first", **change}
    with pytest.raises(EvalError, match=words):
        tapvid_metrics(**arguments)


def test_public_names_are_the_functions() -> None:
    assert decomo_eval.tapvid_metrics is tapvid_metrics
    assert decomo_eval.temporal_coherence is temporal_coherence
    assert callable(decomo_eval.evaluate)
    assert set(decomo_eval.__all__) <= set(dir(decomo_eval))
    with pytest.raises(AttributeError, match="nothing"):
        _ = decomo_eval.nothing  # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.parametrize("query_mode", ["first", "strided"])
def test_reappearing_is_being_seen_again_after_a_hidden_frame_in_between(query_mode: str) -> None:
    random = np.random.default_rng(3)
    occluded = random.random((2, 5, 9)) < 0.4
    queries = np.stack([random.integers(0, 9, (2, 5)), *random.uniform(0, 256, (2, 2, 5))], axis=-1)
    found = reappeared(queries, occluded, query_mode)
    expected = np.zeros_like(occluded)
    for video, point, frame in np.ndindex(occluded.shape):
        asked = int(queries[video, point, 0])
        counts = frame > asked if query_mode == "first" else frame != asked
        hidden = occluded[video, point, min(frame, asked) + 1 : max(frame, asked)]
        expected[video, point, frame] = counts and not occluded[video, point, frame] and hidden.any()
    np.testing.assert_array_equal(found, expected)
    assert expected.any()


@pytest.mark.parametrize("asked", [8.2, 7.6])
def test_reappearing_by_hand(asked: float) -> None:
    """Of a query in frame 8 that is hidden in 3 and 4, frames 0 to 2; what is hidden in its own frame says nothing."""
    occluded = np.zeros((1, 1, 10), bool)
    occluded[0, 0, [3, 4, 8]] = True
    found = reappeared(np.array([[[asked, 5.0, 5.0]]]), occluded, "strided")
    assert np.flatnonzero(found).tolist() == [0, 1, 2]


def test_what_nobody_has_judged_is_not_known_to_be_hidden() -> None:
    """Hidden in frames 2 and 5 of which 5 alone is judged: a point of frame 0 is seen again from frame 6 on."""
    occluded = np.zeros((1, 1, 8), bool)
    occluded[0, 0, [2, 5]] = True
    judged = np.ones_like(occluded)
    judged[0, 0, 2] = False
    query = np.array([[[0.0, 5.0, 5.0]]])
    assert np.flatnonzero(reappeared(query, occluded, "first", judged)).tolist() == [6, 7]
    assert np.flatnonzero(reappeared(query, occluded, "first")).tolist() == [3, 4, 6, 7]


def test_a_query_s_frame_is_the_nearest_one() -> None:
    example = paper_example()
    expected = tapvid_metrics(**example, query_mode="strided")
    again = reappeared(example["query_points"], example["gt_occluded"], "strided")
    for off in (0.4, -0.4):
        example["query_points"][..., 0] = np.array([[0, 1, 0]]) + off
        for name, value in tapvid_metrics(**example, query_mode="strided").items():
            np.testing.assert_array_equal(value, expected[name])
        np.testing.assert_array_equal(reappeared(example["query_points"], example["gt_occluded"], "strided"), again)


@pytest.mark.parametrize("query_mode", ["first", "strided"])
def test_frames_that_nobody_has_judged_count_as_if_they_were_not_there(query_mode: str) -> None:
    example = paper_example()
    judged = np.ones((1, 3, 4), bool)
    judged[..., 2] = False
    without = {key: value if key == "query_points" else np.delete(value, 2, axis=2) for key, value in example.items()}
    expected = tapvid_metrics(**without, query_mode=query_mode)
    for name, value in tapvid_metrics(**example, query_mode=query_mode, judged=judged).items():
        np.testing.assert_array_equal(value, expected[name])


def test_temporal_coherence_of_single_precision_is_that_of_double() -> None:
    random = np.random.default_rng(0)
    true = random.uniform(0, 256, (1, 3, 6, 2)).astype(np.float32)
    predicted = true + random.normal(0, 1e-3, true.shape).astype(np.float32)
    nowhere = np.zeros((1, 3, 6), bool)
    doubled = temporal_coherence(nowhere, true.astype(np.float64), predicted.astype(np.float64))
    np.testing.assert_array_equal(temporal_coherence(nowhere, true, predicted), doubled)

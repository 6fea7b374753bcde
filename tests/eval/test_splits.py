"""Splits of the points: which belong where, worked by hand, and that each is scored like a video of its own."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from decomo_eval.errors import EvalError
from decomo_eval.measure import score
from decomo_eval.metrics import position_accuracy, reappeared, tapvid_metrics
from decomo_eval.predictions import Prediction
from decomo_eval.splits import on_objects, score_splits
from decomo_eval.tapvid import Queries


def flags(*rows: str) -> np.ndarray:
    """[1 video, row, column] bool, True where a row has an `x`."""
    return np.array([[[mark == "x" for mark in row] for row in rows]])


def at(*frames: int) -> np.ndarray:
    """[1 video, query, 3]: queries somewhere in those frames."""
    return np.array([[[frame, 10.0, 10.0] for frame in frames]], dtype=float)


class TestReappeared:
    occluded = flags("...xx..x.", "...xx..x.", "...xx..x.", ".........", "xx....xxx")
    query_points = at(0, 5, 8, 4, 3)

    def test_strided_goes_both_ways(self) -> None:
        expected = flags(
            ".....xx.x",  # seen, hidden in 3 and 4, seen again; hidden in 7, seen again
            "xxx.....x",  # back from 5 through 4 and 3; 6 is its neighbour
            "xxx..xx..",  # back from 8 through 7
            ".........",  # never hidden
            ".........",  # never seen again
        )
        np.testing.assert_array_equal(reappeared(self.query_points, self.occluded, "strided"), expected)

    def test_first_counts_only_later_frames(self) -> None:
        expected = flags(".....xx.x", "........x", ".........", ".........", ".........")
        np.testing.assert_array_equal(reappeared(self.query_points, self.occluded, "first"), expected)

    def test_an_occluded_query_frame_is_not_between(self) -> None:
        np.testing.assert_array_equal(reappeared(at(1), flags(".x.x."), "strided"), flags("....x"))

    @given(seed=st.integers(0, 2**32 - 1), query_mode=st.sampled_from(["first", "strided"]))
    def test_as_the_definition_reads(self, seed: int, query_mode: str) -> None:
        rng = np.random.default_rng(seed)
        occluded = rng.random((2, 3, 7)) < 0.4
        query = rng.integers(0, 7, (2, 3))
        points = np.stack([query, query, query], axis=-1).astype(float)
        expected = np.zeros_like(occluded)
        for video, row, frame in np.ndindex(occluded.shape):
            start = query[video, row]
            between = occluded[video, row, min(start, frame) + 1 : max(start, frame)]
            counted = frame > start if query_mode == "first" else frame != start
            expected[video, row, frame] = counted and not occluded[video, row, frame] and between.any()
        np.testing.assert_array_equal(reappeared(points, occluded, query_mode), expected)


def test_position_accuracy_by_hand() -> None:
    true = np.zeros((1, 1, 4, 2))
    predicted = np.array([[[[0.5, 0], [3, 4], [100, 0], [np.nan, 0]]]])
    shares = position_accuracy(true, predicted, flags("xx.x"))
    assert [shares[f"pts_within_{threshold}"][0] for threshold in (1, 2, 4, 8, 16)] == [1 / 3] * 3 + [2 / 3] * 2
    assert shares["average_pts_within_thresh"][0] == pytest.approx(7 / 15)  # a sum of fractions
    assert math.isnan(position_accuracy(true, predicted, flags("...."))["pts_within_4"][0])


def test_position_accuracy_of_what_counts_is_tap_vid_s() -> None:
    rng = np.random.default_rng(0)
    occluded = rng.random((2, 3, 6)) < 0.4
    true, predicted = rng.normal(scale=4, size=(2, 2, 3, 6, 2))
    whole = tapvid_metrics(np.zeros((2, 3, 3)), occluded, true, occluded, predicted, "strided")
    part = position_accuracy(true, predicted, ~occluded & (np.arange(6) != 0))
    for name, value in part.items():
        np.testing.assert_array_equal(value, whole[name])


def video() -> tuple[Queries, Prediction, np.ndarray]:
    """Two queries on the object, the image's left half in every frame, and one off it."""
    points = np.array([[0.0, 20, 127.9], [1, 200, 0], [1, 20, 128.1]])
    tracks = np.tile(points[:, None, :0:-1], (1, 4, 1))
    queries = Queries(points, tracks, np.zeros((3, 4), bool))
    occluded = np.zeros((3, 4), bool)
    occluded[2] = True
    masks = np.zeros((4, 12, 16), bool)
    masks[:, :, :8] = True
    return queries, Prediction(tracks + np.array([0, 3]), occluded, (256, 256)), masks


def test_static_and_dynamic_queries() -> None:
    queries, prediction, masks = video()
    assert on_objects(queries, masks).tolist() == [True, True, False]
    splits = score_splits(queries, prediction, "strided", masks)
    assert {name: split["count"] for name, split in splits.items()} == {
        **{"static": 1, "dynamic": 2},
        **{"visible": 9, "reappeared": 0, "out_of_frame": 0},
    }
    assert splits["dynamic"]["occlusion_accuracy"] == 1
    assert splits["static"]["occlusion_accuracy"] == 0
    assert splits["static"]["pts_within_4"] == 1
    assert math.isnan(splits["reappeared"]["average_pts_within_thresh"])


def test_a_split_of_all_queries_is_the_whole() -> None:
    queries, prediction, masks = video()
    splits = score_splits(queries, prediction, "first", np.ones_like(masks))
    assert "static" not in splits
    assert splits["dynamic"] == {"count": 3, **score(queries, prediction, "first")}
    assert set(score_splits(queries, prediction, "first")) == {"visible", "reappeared", "out_of_frame"}


def test_points_outside_the_image_belong_to_its_border() -> None:
    queries, _, masks = video()
    outside = Queries(np.array([[0.0, -3, -3], [3, 300, 300]]), queries.tracks[:2], queries.occluded[:2])
    assert on_objects(outside, masks).tolist() == [True, False]


def test_masks_of_another_length() -> None:
    queries, prediction, masks = video()
    with pytest.raises(EvalError, match=r"T = 4 frames, but they are \[3, 12, 16\]"):
        score_splits(queries, prediction, "strided", masks[:3])


def test_out_of_frame_asks_for_occlusion_where_the_hidden_truth_is_outside() -> None:
    tracks = np.array([[[10.0, 10], [-3, 10], [20, 260], [30, 30], [-5, 5]]])
    occluded = np.array([[False, True, True, True, False]])  # frame 3: hidden inside; frame 4: outside, yet seen
    queries = Queries(np.array([[0, 10.0, 10]]), tracks, occluded)
    said = np.array([[True, True, False, False, False]])
    splits = score_splits(queries, Prediction(tracks, said, (256, 256)), "first")
    assert splits["out_of_frame"] == {"count": 2, "occlusion_accuracy": 0.5}
    assert splits["visible"]["count"] == 0
    assert splits["reappeared"]["count"] == 1


def test_frames_without_annotation_are_in_no_split() -> None:
    """Neither does a point come back after them, nor is it out of the frame in them."""
    occluded = np.array([[False, True, False, True, True]])
    judged = np.array([[True, False, True, True, False]])
    tracks = np.full((1, 5, 2), 300.0)
    queries = Queries(np.array([[0, 10.0, 10]]), tracks, occluded, judged)
    answer = Prediction(tracks, np.array([[False, False, False, True, False]]), (256, 256))
    splits = score_splits(queries, answer, "first")
    assert (splits["visible"]["count"], splits["reappeared"]["count"]) == (1, 0)
    assert np.isnan(splits["reappeared"]["redetection_jaccard"])
    assert splits["out_of_frame"] == {"count": 1, "occlusion_accuracy": 1}
    known = score_splits(replace(queries, judged=None), answer, "first")
    assert (known["visible"]["count"], known["reappeared"]["count"], known["out_of_frame"]["count"]) == (0, 1, 3)
    assert known["reappeared"]["redetection_jaccard"] > 0


def test_the_image_s_edge_belongs_to_it() -> None:
    """It spans 0 to 256."""
    tracks = np.array([[[10.0, 10], [0, 256], [256, 0], [256.1, 10], [10, -0.1]]])
    occluded = np.array([[False, True, True, True, True]])
    queries = Queries(np.array([[0, 10.0, 10]]), tracks, occluded)
    splits = score_splits(queries, Prediction(tracks, occluded, (256, 256)), "first")
    assert splits["out_of_frame"] == {"count": 2, "occlusion_accuracy": 1}


@pytest.mark.parametrize("off", [0.4, -0.4])
def test_a_query_is_on_what_its_nearest_frame_shows(off: float) -> None:
    queries, _, masks = video()
    masks[0] = masks[2:] = False
    points = queries.points + np.array([off, 0, 0])
    assert on_objects(replace(queries, points=points), masks).tolist() == [False, True, False]

"""Query sampling and the two coordinate systems."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from decomo_eval.dataset import Video
from decomo_eval.errors import EvalError
from decomo_eval.tapvid import pixels_to_raster, raster_to_pixels, sample_queries


def make_video(occluded: np.ndarray) -> Video:
    points = np.random.default_rng(0).random((*occluded.shape, 2))
    frames = np.zeros((occluded.shape[1], 4, 6, 3), np.uint8)
    return Video("a", frames, height=4, width=6, points=points, occluded=occluded)


def hidden_but(num_frames: int, *visible: list[int]) -> np.ndarray:
    """occluded [N, T], each track visible in the listed frames."""
    occluded = np.ones((len(visible), num_frames), dtype=bool)
    for track, frames in enumerate(visible):
        occluded[track, frames] = False
    return occluded


def test_first_queries_each_track_where_it_appears() -> None:
    video = make_video(hidden_but(7, [2, 3, 6], [], [0, 5]))
    queries = sample_queries(video, "first")
    (x0, y0), (x1, y1) = video.points[0, 2] * 256, video.points[2, 0] * 256
    np.testing.assert_array_equal(queries.points, [[2, y0, x0], [0, y1, x1]])
    np.testing.assert_array_equal(queries.tracks, video.points[[0, 2]] * 256)
    np.testing.assert_array_equal(queries.occluded, video.occluded[[0, 2]])


def test_strided_queries_every_fifth_frame() -> None:
    video = make_video(hidden_but(11, [0, 1, 5, 10], [1, 2, 3], [0, 10]))
    queries = sample_queries(video, "strided")
    track = [0, 2, 0, 0, 2]
    frame = [0, 0, 5, 10, 10]
    xy = video.points[track, frame] * 256
    np.testing.assert_array_equal(queries.points, np.column_stack([frame, xy[:, 1], xy[:, 0]]))
    np.testing.assert_array_equal(queries.tracks, video.points[track] * 256)
    np.testing.assert_array_equal(queries.occluded, video.occluded[track])


@pytest.mark.parametrize("query_mode", ["first", "strided"])
def test_a_video_without_visible_track_has_no_queries(query_mode: str) -> None:
    queries = sample_queries(make_video(hidden_but(6, [], [])), query_mode)
    assert queries.points.shape == (0, 3)
    assert queries.tracks.shape == (0, 6, 2)
    assert queries.occluded.shape == (0, 6)
    assert queries.in_pixels(6, 4).shape == (0, 3)


def test_an_unknown_mode_is_named() -> None:
    with pytest.raises(EvalError, match="'dense'"):
        sample_queries(make_video(hidden_but(6, [0])), "dense")


def test_pixel_centres_and_edges() -> None:
    # The first pixel of a 256x256 image has its centre at raster (0.5, 0.5).
    np.testing.assert_array_equal(pixels_to_raster([0, 0], 256, 256), [0.5, 0.5])
    # The image's edges are 0 and 256 for any size.
    np.testing.assert_array_equal(pixels_to_raster([[-0.5, -0.5], [511.5, 127.5]], 512, 128), [[0, 0], [256, 256]])
    # In an image twice as wide, raster pixel 10 (centre 10.5) covers pixels 20 and 21; the middle is 20.5.
    np.testing.assert_array_equal(raster_to_pixels([10.5, 10.5], 512, 256), [20.5, 10])


@settings(deadline=None, max_examples=50)
@given(
    x=st.floats(-100, 400),
    y=st.floats(-100, 400),
    width=st.integers(1, 4000),
    height=st.integers(1, 4000),
)
def test_there_and_back(x: float, y: float, width: int, height: int) -> None:
    back = pixels_to_raster(raster_to_pixels([x, y], width, height), width, height)
    # A subtraction and an addition of 0.5 in float64; on an image of one pixel they cost 256 times the rounding.
    np.testing.assert_allclose(back, [x, y], atol=1e-10)


def test_queries_in_pixels_are_t_x_y() -> None:
    video = make_video(hidden_but(7, [2, 3]))
    query = sample_queries(video, "first").in_pixels(video.width, video.height)
    assert query.dtype == np.float32
    # Fractions of width and height, half a pixel to the left of and above where TAP-Vid counts from.
    expected = [[2, *(video.points[0, 2] * [6, 4] - 0.5)]]
    np.testing.assert_allclose(query, expected, rtol=1e-6)  # float32


@pytest.mark.parametrize("query_mode", ["first", "strided"])
def test_what_is_judged_goes_with_its_track(query_mode: str) -> None:
    video = make_video(hidden_but(7, [2, 3, 6], [], [0, 5]))
    judged = np.random.default_rng(1).random((3, 7)) < 0.5
    queries = sample_queries(replace(video, judged=judged), query_mode)
    tracks = [0, 2] if query_mode == "first" else [2, 2]
    np.testing.assert_array_equal(queries.judged, judged[tracks])
    some = queries.chosen(np.array([False, True]))
    np.testing.assert_array_equal(some.judged, judged[[2]])
    np.testing.assert_array_equal(some.tracks, queries.tracks[1:])
    assert sample_queries(video, query_mode).chosen(np.array([False, True])).judged is None

"""Answers from files and from models, brought to the raster; answers to other questions are refused."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from decomo_eval.dataset import Video, read_dataset
from decomo_eval.errors import PredictionError
from decomo_eval.predictions import check_axes, from_model, from_npz
from decomo_eval.tapvid import Queries, sample_queries

WritePredictions = Callable[..., Path]


@pytest.fixture
def left(dataset: Path) -> tuple[Video, Queries]:
    video = read_dataset(dataset)["left"]
    return video, sample_queries(video, "strided")


@pytest.mark.parametrize("size", [None, (854, 480), (7, 5)])
def test_npz_comes_back_to_the_raster(
    write_predictions: WritePredictions, left: tuple[Video, Queries], size: tuple[int, int] | None
) -> None:
    prediction = from_npz(write_predictions("left", size=size) / "left.npz", *left)
    # Tracks are float32 in the file; a small frame is magnified to 256.
    np.testing.assert_allclose(prediction.tracks, left[1].tracks, rtol=1e-5)
    np.testing.assert_array_equal(prediction.occluded, left[1].occluded, strict=True)


def test_queries_may_be_rounded_to_two_decimals(
    write_predictions: WritePredictions, left: tuple[Video, Queries]
) -> None:
    queries = left[1].in_pixels(256, 256).round(2)
    assert from_npz(write_predictions("left", size=(256, 256), queries=queries) / "left.npz", *left)


def test_numbers_may_stand_for_occluded(write_predictions: WritePredictions, left: tuple[Video, Queries]) -> None:
    occluded = left[1].occluded.astype(np.int64)
    prediction = from_npz(write_predictions("left", occluded=occluded) / "left.npz", *left)
    np.testing.assert_array_equal(prediction.occluded, left[1].occluded, strict=True)


def half_a_pixel_off(queries: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    return queries + np.array([0, 0.5, 0.5], np.float32)


@pytest.mark.parametrize(
    ("key", "change", "words"),
    [
        ("queries", lambda a: None, "lacks the key queries"),
        ("tracks", lambda a: None, "lacks the key tracks"),
        ("queries", lambda a: a[:-1], "other mode"),
        ("queries", lambda a: a[::-1], "has query 0 at .* but the benchmark's is at .* 32x20 frames"),
        ("queries", half_a_pixel_off, "benchmark's order"),
        ("queries", lambda a: a + np.array([1, 0, 0], np.float32), "has query 0 at .* but the benchmark's is at"),
        ("queries", lambda a: a.astype(str), "numbers as queries"),
        ("queries", lambda a: a * np.float32(np.nan), "has query 0"),
        ("tracks", lambda a: a[:, :-1], "query, frame"),
        ("tracks", lambda a: a.astype(str), "numbers as tracks"),
        ("occluded", lambda a: a.T, "query, frame"),
        ("occluded", lambda a: a * 0.3, "true or false as occluded"),
        ("occluded", lambda a: a.astype(str), "true or false as occluded"),
    ],
)
def test_answers_to_other_questions_are_refused(
    write_predictions: WritePredictions,
    left: tuple[Video, Queries],
    key: str,
    change: Callable[[npt.NDArray[Any]], Any],
    words: str,
) -> None:
    file = write_predictions("left") / "left.npz"
    with np.load(file) as arrays:
        right = arrays[key]
    write_predictions("left", **{key: change(right)})
    with pytest.raises(PredictionError, match=words):
        from_npz(file, *left)


@pytest.mark.parametrize("query_mode", ["first", "strided"])
def test_as_many_queries_as_frames_do_not_hide_another_order(
    dataset: Path,
    dataset_content: dict[str, Any],
    write_predictions: WritePredictions,
    query_mode: str,
) -> None:
    rng = np.random.default_rng(3)
    entry, frames = dataset_content["left"], 11
    points = frames if query_mode == "first" else 4  # strided: asked in frames 0, 5 and 10
    entry["points"] = rng.uniform(0.1, 0.9, (points, 1, 2)) + 0.002 * rng.normal(size=(points, frames, 2))
    entry["occluded"] = np.zeros((points, frames), bool)
    entry["occluded"][-1, 5] = True
    dataset.write_bytes(pickle.dumps(dataset_content))
    video = read_dataset(dataset)["left"]
    queries = sample_queries(video, query_mode)
    assert len(queries.points) == video.num_frames
    file = write_predictions("left", query_mode=query_mode) / "left.npz"
    np.testing.assert_allclose(from_npz(file, video, queries).tracks, queries.tracks, atol=1e-3)
    with np.load(file) as arrays:
        turned = {key: arrays[key].swapaxes(0, 1) for key in ("tracks", "occluded")}
    write_predictions("left", query_mode=query_mode, **turned)
    with pytest.raises(PredictionError, match="queries and frames exchanged, of which there are 11 each"):
        from_npz(file, video, queries)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_lost_point_is_named(axis: int, write_predictions: WritePredictions, left: tuple[Video, Queries]) -> None:
    tracks = left[1].tracks.copy()
    tracks[2, 7, axis] = np.nan
    with pytest.raises(PredictionError, match="no finite position for query 2 in frame 7"):
        from_npz(write_predictions("left", tracks=tracks) / "left.npz", *left)


@pytest.mark.parametrize("extra", [{"width": 854}, {"width": 854, "height": 0}, {"width": "854", "height": "480"}])
def test_half_a_size_is_refused(
    write_predictions: WritePredictions, left: tuple[Video, Queries], extra: dict[str, Any]
) -> None:
    with pytest.raises(PredictionError, match="both width and height"):
        from_npz(write_predictions("left", **extra) / "left.npz", *left)


def test_tracks_of_some_frames_only_are_refused(
    write_predictions: WritePredictions, left: tuple[Video, Queries]
) -> None:
    assert from_npz(write_predictions("left", frames=np.arange(11)) / "left.npz", *left)
    with pytest.raises(PredictionError, match="all 11 frames of video left"):
        from_npz(write_predictions("left", frames=np.arange(1, 12)) / "left.npz", *left)


def test_files_that_are_no_npz_are_refused(tmp_path: Path, left: tuple[Video, Queries]) -> None:
    words = "is not an .npz file of plain arrays"
    file = tmp_path / "left.npz"
    file.write_bytes(b"no archive")
    with pytest.raises(PredictionError, match=words):
        from_npz(file, *left)
    with open(file, "wb") as single:
        np.save(single, np.zeros(3))
    with pytest.raises(PredictionError, match=words):
        from_npz(file, *left)
    np.savez(file, queries=np.array([{"an": "object"}], dtype=object))
    with pytest.raises(PredictionError, match=words):
        from_npz(file, *left)


class StillTracker:
    """A stand-in for `decomo_runtime.Tracker`, fitted to 854x480 frames, that leaves every point where it is."""

    num_frames, width, height = 11, 854, 480
    asked: npt.NDArray[np.float32]

    def __init__(self, path: Path) -> None:
        pass

    def track(self, queries: npt.NDArray[np.float32]) -> Any:
        StillTracker.asked = queries
        return type(
            "Tracks",
            (),
            {
                "xy": np.repeat(queries[:, None, 1:], self.num_frames, axis=1),
                "occluded": np.zeros((len(queries), self.num_frames), bool),
                "occlusion": np.zeros((len(queries), self.num_frames), np.float32),
            },
        )()


def test_a_model_of_another_size_is_asked_in_its_pixels(
    left: tuple[Video, Queries], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("decomo_runtime.Tracker", StillTracker, raising=False)
    video, queries = left
    prediction = from_model(Path("left.onnx"), video, queries)
    xy = queries.points[:, :0:-1]
    # An image of 854x480 has x from -0.5 to 853.5 where the raster has it from 0 to 256. Rounding of float32.
    expected = np.column_stack([queries.points[:, 0], xy * [854 / 256, 480 / 256] - 0.5])
    np.testing.assert_allclose(StillTracker.asked, expected, rtol=1e-5)
    assert StillTracker.asked.dtype == np.float32
    np.testing.assert_allclose(prediction.tracks, np.repeat(xy[:, None], 11, axis=1), rtol=1e-5)
    assert not prediction.occluded.any()


def test_a_query_just_outside_the_image_is_asked_at_its_edge(
    left: tuple[Video, Queries], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("decomo_runtime.Tracker", StillTracker, raising=False)
    video, queries = left
    queries.points[0, 1:] = -0.3, 256.2  # y, x
    from_model(Path("left.onnx"), video, queries)
    np.testing.assert_array_equal(StillTracker.asked[0, 1:], [853.5, -0.5])


def test_a_model_of_another_length_is_refused(left: tuple[Video, Queries], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("decomo_runtime.Tracker", StillTracker, raising=False)
    monkeypatch.setattr(StillTracker, "num_frames", 50)
    with pytest.raises(PredictionError, match="fitted to 50 frames but video left has 11"):
        from_model(Path("left.onnx"), *left)


@pytest.mark.parametrize("size", [(20, 32), (10, 16), (480, 768), (480, 770)])
def test_a_model_of_turned_frames_is_refused(
    size: tuple[int, int], left: tuple[Video, Queries], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("decomo_runtime.Tracker", StillTracker, raising=False)
    monkeypatch.setattr(StillTracker, "width", size[0])
    monkeypatch.setattr(StillTracker, "height", size[1])
    with pytest.raises(
        PredictionError, match=rf"frames of {size[0]}x{size[1]} but video left has 32x20: one of the two"
    ):
        from_model(Path("left.onnx"), *left)


def test_predictions_in_turned_frames_are_refused(
    write_predictions: WritePredictions, left: tuple[Video, Queries]
) -> None:
    file = write_predictions("left", size=(20, 32)) / "left.npz"
    with pytest.raises(PredictionError, match="one of the two is turned"):
        from_npz(file, *left)


@pytest.mark.parametrize("size", [(256, 256), (854, 480), (32, 20), (16, 10), (20, 20)])
def test_frames_of_other_sizes_are_not_turned(
    size: tuple[int, int], write_predictions: WritePredictions, left: tuple[Video, Queries]
) -> None:
    assert from_npz(write_predictions("left", size=size) / "left.npz", *left).size == size


def test_predictions_in_turned_frames_of_an_upright_video_are_refused(
    write_predictions: WritePredictions, left: tuple[Video, Queries]
) -> None:
    """The video is higher than wide, and the file's frames lie on their side."""
    video, queries = replace(left[0], height=32, width=20), left[1]
    assert from_npz(write_predictions("left", size=(20, 32)) / "left.npz", video, queries)
    with pytest.raises(PredictionError, match="frames of 32x20 but video left has 20x32: one of the two is turned"):
        from_npz(write_predictions("left", size=(32, 20)) / "left.npz", video, queries)


def test_a_file_of_ours_that_names_no_size_is_of_the_stored_frames(
    write_predictions: WritePredictions, left: tuple[Video, Queries]
) -> None:
    file = write_predictions("left", size=(256, 256), width=None, height=None) / "left.npz"
    with pytest.raises(PredictionError, match=r"has query 0 at .* in pixels of 32x20 frames; .* by width and height"):
        from_npz(file, *left)


def test_what_lies_about_where_x_is_y_is_not_taken_to_be_exchanged() -> None:
    """Off by a fraction of a pixel, exchanged they would be nearer."""
    asked = np.array([[0, 10.0, 10.5], [2, 40, 40.5], [1, 7, 7.5]])
    tracks = np.tile(asked[:, None, 2:0:-1], (1, 4, 1))
    check_axes("a.npz", tracks, asked)
    asked[:, 2] += 3
    tracks = np.tile(asked[:, None, 2:0:-1], (1, 4, 1))
    with pytest.raises(
        PredictionError, match=r"a\.npz has tracks that lie at their queries only with x and y exchanged"
    ):
        check_axes("a.npz", tracks, asked)

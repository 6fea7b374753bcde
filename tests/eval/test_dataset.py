"""TAP-Vid's file forms, and what is wrong with those that are not."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from clip_files import turned_jpeg
from decomo_eval.dataset import Video, read_dataset
from decomo_eval.errors import DatasetError


@pytest.fixture
def read(tmp_path: Path) -> Callable[[Any], dict[str, Video]]:
    def read(content: Any) -> dict[str, Video]:
        path = tmp_path / "dataset.pkl"
        path.write_bytes(pickle.dumps(content))
        return dict(read_dataset(path))

    return read


def encoded(frames: np.ndarray, suffix: str) -> list[bytes]:
    """RGB frames as image files."""
    return [cv2.imencode(suffix, np.ascontiguousarray(frame[..., ::-1]))[1].tobytes() for frame in frames]


def test_a_dict_keeps_names_and_order(read: Callable[..., Any], dataset_content: dict[str, Any]) -> None:
    videos = read(dataset_content)
    assert list(videos) == ["left", "right"]
    left = videos["left"]
    assert (left.name, left.num_frames, left.height, left.width) == ("left", 11, 20, 32)
    np.testing.assert_array_equal(left.frames(), dataset_content["left"]["video"], strict=True)
    np.testing.assert_array_equal(left.points, dataset_content["left"]["points"], strict=True)
    np.testing.assert_array_equal(left.occluded, dataset_content["left"]["occluded"], strict=True)


def test_frames_are_brought_to_256x256(tmp_path: Path, entry: dict[str, Any]) -> None:
    """Fourfold in each direction here: every pixel is the mean of sixteen; tracks are fractions and stay."""
    ramp = np.arange(11, dtype=np.uint8)[:, None, None, None] * 20 + np.zeros((11, 1024, 1024, 3), np.uint8)
    ramp[:, ::4] += 8
    for video in (ramp, encoded(ramp, ".png")):
        (tmp_path / "dataset.pkl").write_bytes(pickle.dumps({"a": {**entry, "video": video}}))
        small = read_dataset(tmp_path / "dataset.pkl", "256x256")["a"]
        assert (small.height, small.width) == (256, 256)
        expected = np.broadcast_to(np.arange(11)[:, None, None, None] * 20 + 2, (11, 256, 256, 3))
        np.testing.assert_array_equal(small.frames(), expected)
        np.testing.assert_array_equal(small.points, entry["points"])
    with pytest.raises(DatasetError, match="there is no resolution 512; choose of original, 256x256"):
        read_dataset(tmp_path / "dataset.pkl", "512")


def test_a_digest_is_of_the_frames(read: Callable[..., Any], entry: dict[str, Any]) -> None:
    video = read({"a": entry})["a"]
    same = read({"b": {**entry, "points": entry["points"] + 0.01}})["b"]
    changed = read({"a": {**entry, "video": entry["video"] ^ 1}})["a"]
    assert video.digest() == same.digest()
    assert len({video.digest(), changed.digest(), video.at(256, 256).digest()}) == 3


def test_a_list_is_named_by_position(read: Callable[..., Any], dataset_content: dict[str, Any]) -> None:
    videos = read(list(dataset_content.values()))
    assert list(videos) == ["0", "1"]
    np.testing.assert_array_equal(videos["1"].points, dataset_content["right"]["points"])


def test_png_bytes_decode_exactly(read: Callable[..., Any], entry: dict[str, Any]) -> None:
    video = read({"a": {**entry, "video": encoded(entry["video"], ".png")}})["a"]
    assert (video.height, video.width) == (20, 32)
    np.testing.assert_array_equal(video.frames(), entry["video"], strict=True)


def test_jpeg_bytes_decode_as_rgb(read: Callable[..., Any], entry: dict[str, Any]) -> None:
    colours = np.zeros((11, 20, 32, 3), np.uint8) + np.array([200, 100, 20], np.uint8)
    frames = read({"a": {**entry, "video": encoded(colours, ".jpg")}})["a"].frames()
    assert frames.shape == colours.shape
    # JPEG rounds a flat colour by a few levels.
    np.testing.assert_allclose(frames, colours, atol=3)


def test_jpeg_bytes_are_not_turned(read: Callable[..., Any], entry: dict[str, Any]) -> None:
    """As by the official reader, whose tracks are in the stored frames."""
    frames = [turned_jpeg(frame, 6) for frame in entry["video"]]
    video = read({"a": {**entry, "video": frames}})["a"]
    assert (video.height, video.width) == (20, 32)
    plain = read({"a": {**entry, "video": [turned_jpeg(frame, 1) for frame in entry["video"]]}})["a"]
    np.testing.assert_array_equal(video.frames(), plain.frames())


def test_png_bytes_of_16_bits(read: Callable[..., Any], entry: dict[str, Any]) -> None:
    deep = [cv2.imencode(".png", frame[..., ::-1].astype(np.uint16) * 257)[1].tobytes() for frame in entry["video"]]
    np.testing.assert_array_equal(read({"a": {**entry, "video": deep}})["a"].frames(), entry["video"])


def test_occluded_may_be_numbers(read: Callable[..., Any], entry: dict[str, Any]) -> None:
    video = read({"a": {**entry, "occluded": entry["occluded"].astype(np.float64)}})["a"]
    np.testing.assert_array_equal(video.occluded, entry["occluded"], strict=True)


def test_hidden_points_may_be_anywhere(read: Callable[..., Any], entry: dict[str, Any]) -> None:
    entry["points"][entry["occluded"]] = np.nan
    assert read({"a": entry})["a"].num_frames == 11


def without(entry: dict[str, Any], key: str) -> dict[str, Any]:
    return {name: value for name, value in entry.items() if name != key}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda entry: {}, "holds no videos"),
        (lambda entry: "goat", "holds a str"),
        (lambda entry: {"a": [1]}, "video a of .* lacks one of the keys"),
        (lambda entry: {"a": without(entry, "occluded")}, "lacks one of the keys video, points, occluded"),
        (lambda entry: {"a": {**entry, "points": entry["points"][0]}}, r"points \[N, T, 2\]"),
        (lambda entry: {"a": {**entry, "points": "here"}}, "array of numbers as points"),
        (lambda entry: {"a": {**entry, "points": entry["points"] * 256}}, "divide x by the width"),
        (lambda entry: {"a": {**entry, "points": entry["points"] * np.nan}}, "not finite"),
        (lambda entry: {"a": {**entry, "occluded": entry["occluded"] * 2}}, "only true and false"),
        (lambda entry: {"a": {**entry, "video": entry["video"][:5]}}, "as many frames as points and occluded, 11"),
        (lambda entry: {"a": {**entry, "video": entry["video"] / 255}}, "uint8 array"),
        (lambda entry: {"a": {**entry, "video": ["a.jpg"] * 11}}, "uint8 array"),
        (lambda entry: {"a": {**entry, "video": [b"no image"] * 11}}, "frame 0 of video a does not decode"),
        (lambda entry: {"a": {**entry, "video": [b""] * 11}}, "frame 0 of video a does not decode"),
    ],
)
def test_other_contents_are_refused(
    read: Callable[..., Any], entry: dict[str, Any], change: Callable[[dict[str, Any]], Any], words: str
) -> None:
    with pytest.raises(DatasetError, match=words):
        read(change(entry))


def test_later_frames_are_checked_when_decoded(read: Callable[..., Any], entry: dict[str, Any]) -> None:
    frames = encoded(entry["video"], ".png")
    video = read({"a": {**entry, "video": [*frames[:-1], b"no image"]}})["a"]
    with pytest.raises(DatasetError, match="frame 10 of video a does not decode"):
        video.frames()[10]
    smaller = encoded(entry["video"][:, :10], ".png")
    video = read({"a": {**entry, "video": [*frames[:-1], smaller[0]]}})["a"]
    with pytest.raises(DatasetError, match="frame 10 of video a differs in size"):
        video.frames()[10]


def test_names_may_be_numbers(read: Callable[..., Any], dataset_content: dict[str, Any]) -> None:
    """Predictions lie in files of their names."""
    videos = read(dict(zip((3, 10), dataset_content.values(), strict=True)))
    assert list(videos) == ["3", "10"]
    assert videos["10"].name == "10"
    with pytest.raises(DatasetError, match="must name its videos by text"):
        read({1.5: dataset_content["left"]})

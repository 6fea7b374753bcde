"""Datasets that are folders: shards of pickles, and frames beside tracks."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from clip_files import turned_jpeg
from decomo_eval.dataset import read_dataset
from decomo_eval.errors import DatasetError, UnsafePickleError
from decomo_eval.readers import tapvid as module
from decomotion.clip import read_clip


def as_jpegs(entry: dict[str, Any], form: Callable[[list[bytes]], Any] = np.array) -> dict[str, Any]:
    """By default as TAP-Vid-Kinetics has it: an array of byte strings."""
    return {**entry, "video": form([cv2.imencode(".jpg", frame)[1].tobytes() for frame in entry["video"]])}


def test_shards_that_are_lists_and_dicts(
    tmp_path: Path, dataset_content: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    left, right = dataset_content.values()
    (tmp_path / "0000_of_0002.pkl").write_bytes(pickle.dumps([as_jpegs(left), as_jpegs(right, list)]))
    (tmp_path / "0001_of_0002.pkl").write_bytes(pickle.dumps({"robot": right}))
    videos = read_dataset(tmp_path)
    assert list(videos) == ["0000_of_0002-0", "0000_of_0002-1", "robot"]
    loads = []
    load = module.safe_pickle.load
    monkeypatch.setattr(module.safe_pickle, "load", lambda path: loads.append(path.name) or load(path))
    for name, entry in zip(videos, (left, right, right), strict=True):
        assert videos[name].name == name
        np.testing.assert_array_equal(videos[name].points, entry["points"])
        assert videos[name].frames().shape == entry["video"].shape
    # asked many times, read once each: the last shard is kept (the last of the names' reading, too)
    assert loads == ["0000_of_0002.pkl", "0001_of_0002.pkl"]


def test_one_name_in_two_shards_is_refused(tmp_path: Path, dataset_content: dict[str, Any]) -> None:
    for shard in ("a.pkl", "b.pkl"):
        (tmp_path / shard).write_bytes(pickle.dumps({"same": dataset_content["left"]}))
    with pytest.raises(DatasetError, match=r"b.pkl and .*a.pkl both have a video same"):
        read_dataset(tmp_path)


def test_a_malicious_shard_is_refused(tmp_path: Path) -> None:
    mark = tmp_path / "executed"
    (tmp_path / "evil.pkl").write_bytes(b"cposix\nsystem\n(Vtouch " + str(mark).encode() + b"\ntR.")
    with pytest.raises(UnsafePickleError):
        read_dataset(tmp_path)
    assert not mark.exists()


def write_folder(folder: Path, entry: dict[str, Any], **replaced: Any) -> None:
    (folder / "goat").mkdir()
    for index, frame in enumerate(entry["video"]):
        cv2.imwrite(str(folder / "goat" / f"{index}.png"), frame[..., ::-1])
    height, width = entry["video"].shape[1:3]
    tracks = entry["points"] * [width, height] - 0.5
    np.savez(folder / "goat.npz", **{"tracks": tracks, "occluded": entry["occluded"], **replaced})


def test_frames_beside_tracks_are_the_same_video(tmp_path: Path, entry: dict[str, Any]) -> None:
    write_folder(tmp_path, entry)
    video = read_dataset(tmp_path)["goat"]
    np.testing.assert_allclose(video.points, entry["points"], rtol=1e-12)
    np.testing.assert_array_equal(video.frames(), entry["video"])  # eleven frames: 10.png comes last
    assert (video.width, video.height) == (32, 20)


def test_hidden_files_are_no_videos(tmp_path: Path, entry: dict[str, Any]) -> None:
    write_folder(tmp_path, entry)
    for name in ("._goat.npz", ".goat.123.partial.npz", "._shard.pkl"):
        (tmp_path / name).write_bytes(b"half")
    assert list(read_dataset(tmp_path)) == ["goat"]


def test_what_a_folder_lacks_is_named(tmp_path: Path, entry: dict[str, Any]) -> None:
    with pytest.raises(
        DatasetError,
        match=r"holds no dataset that is known \(tapvid: a pickle, or a folder of .pkl; folder: a folder of",
    ):
        read_dataset(tmp_path)
    np.savez(tmp_path / "alone.npz", tracks=entry["points"], occluded=entry["occluded"])
    with pytest.raises(DatasetError, match=r"and .*alone the video's frames"):
        read_dataset(tmp_path)["alone"]
    write_folder(tmp_path, entry, tracks=entry["points"][0])
    with pytest.raises(DatasetError, match=r"must have tracks \[N, T, 2\]"):
        read_dataset(tmp_path)["goat"]


@pytest.mark.parametrize("orientation", [3, 5, 6, 8])
def test_frames_in_folders_are_those_of_decomo_train(orientation: int, tmp_path: Path, entry: dict[str, Any]) -> None:
    """Upright, where EXIF tells that they are not stored so."""
    folder = tmp_path / "phone"
    folder.mkdir()
    for index, frame in enumerate(entry["video"]):
        (folder / f"{index}.jpg").write_bytes(turned_jpeg(frame, orientation))
    clip = read_clip(folder)
    tracks = entry["points"] * [clip.width, clip.height] - 0.5
    np.savez(tmp_path / "phone.npz", tracks=tracks, occluded=entry["occluded"])
    video = read_dataset(tmp_path)["phone"]
    assert (video.width, video.height) == (clip.width, clip.height)
    np.testing.assert_array_equal(video.frames(), clip.frames)
    np.testing.assert_allclose(video.points, entry["points"], rtol=1e-12)
    assert read_dataset(tmp_path)["phone"].digest() == video.digest()


def test_deep_frames_in_folders_are_those_of_decomo_train(tmp_path: Path, entry: dict[str, Any]) -> None:
    (tmp_path / "raw").mkdir()
    for index, frame in enumerate(entry["video"]):
        cv2.imwrite(str(tmp_path / "raw" / f"{index}.png"), frame.astype(np.uint16) << 4)
    np.savez(tmp_path / "raw.npz", tracks=entry["points"] * [32, 20], occluded=entry["occluded"])
    np.testing.assert_array_equal(read_dataset(tmp_path)["raw"].frames(), entry["video"][..., ::-1])


def test_frames_that_cannot_be_read_are_the_datasets_fault(tmp_path: Path, entry: dict[str, Any]) -> None:
    """`decomo-bench` goes on with the others."""
    write_folder(tmp_path, entry)
    (tmp_path / "goat" / "10.png").write_bytes(b"no picture")
    with pytest.raises(DatasetError, match=r"frame .*10\.png does not decode as an image"):
        read_dataset(tmp_path)["goat"].frames()[10]
    (tmp_path / "goat" / "0.png").write_bytes(b"no picture")
    with pytest.raises(DatasetError, match=r"frame .*0\.png does not decode as an image"):
        read_dataset(tmp_path)["goat"]
    (tmp_path / "goat" / "0.jpg").write_bytes(b"a second one")
    with pytest.raises(DatasetError, match=r"0\.jpg and 0\.png differ in their ending alone"):
        read_dataset(tmp_path)["goat"]


def test_a_shard_that_cannot_be_read_costs_its_own_videos_where_somebody_is_told(
    tmp_path: Path, dataset_content: dict[str, Any]
) -> None:
    (tmp_path / "a.pkl").write_bytes(b"no pickle")
    with pytest.raises(DatasetError):
        read_dataset(tmp_path)
    refused: list[str] = []
    with pytest.raises(DatasetError):  # nothing else is there
        read_dataset(tmp_path, refused=lambda shard, _: refused.append(shard.name))
    (tmp_path / "b.pkl").write_bytes(pickle.dumps({"robot": dataset_content["right"]}))
    assert list(read_dataset(tmp_path, refused=lambda shard, _: refused.append(shard.name))) == ["robot"]
    assert refused == ["a.pkl"]


def test_tracks_have_two_coordinates(tmp_path: Path, entry: dict[str, Any]) -> None:
    tracks = np.concatenate([entry["points"] * 20, np.ones((*entry["occluded"].shape, 1))], axis=-1)
    write_folder(tmp_path, entry, tracks=tracks)
    with pytest.raises(DatasetError, match=r"must have tracks \[N, T, 2\], but they are \[4, 11, 3\]"):
        read_dataset(tmp_path)["goat"]


def test_what_else_a_file_holds_is_not_read(tmp_path: Path, entry: dict[str, Any]) -> None:
    write_folder(tmp_path, entry, notes=np.array([{"an": "object"}], dtype=object))
    np.testing.assert_allclose(read_dataset(tmp_path)["goat"].points, entry["points"], rtol=1e-12)

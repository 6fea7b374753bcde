"""Dynamic Replica: the left camera's frames, with tensors in files of torch that torch does not read."""

from __future__ import annotations

import gzip
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dataset_files import FRAMES, HEIGHT, WIDTH, write_annotations, write_dynamic_replica
from decomo_eval import figures
from decomo_eval.dataset import read_dataset
from decomo_eval.errors import DatasetError, UnsafePickleError
from decomo_eval.readers import dynamic_replica

SEQUENCE = "009850-3_obj_source"


def entries(root: Path) -> list[dict[str, Any]]:
    return json.loads(gzip.decompress((root / "frame_annotations_valid.jgz").read_bytes()))


def test_a_sequence(tmp_path: Path) -> None:
    truth = write_dynamic_replica(tmp_path)
    videos = read_dataset(tmp_path)
    assert list(videos) == [SEQUENCE]
    video = videos[SEQUENCE]
    kept = truth["visible"].sum(axis=0) > 10
    assert 3 < kept.sum() < len(kept)
    np.testing.assert_array_equal(~video.occluded, truth["visible"].T[kept])
    np.testing.assert_allclose(video.points * [WIDTH, HEIGHT], truth["xy"].swapaxes(0, 1)[kept], rtol=1e-6)
    np.testing.assert_array_equal(
        video.frames()[0], np.random.default_rng(0).integers(0, 256, (FRAMES, HEIGHT, WIDTH, 3), np.uint8)[0]
    )


def test_its_own_figures(tmp_path: Path) -> None:
    write_dynamic_replica(tmp_path)
    video = read_dataset(tmp_path)[SEQUENCE]
    tracks = video.points * 256 + np.random.default_rng(6).normal(0, 5, video.points.shape)
    assert video.figures is not None
    assert video.figures(tracks, video.occluded) == figures.dynamic_replica(
        tracks, video.points * 256, ~video.occluded, (WIDTH, HEIGHT)
    )


def test_a_point_beyond_the_last_pixel_is_hidden(tmp_path: Path) -> None:
    import torch

    write_dynamic_replica(tmp_path)
    before = read_dataset(tmp_path)[SEQUENCE]
    file = tmp_path / entries(tmp_path)[4]["trajectories"]["path"]
    tensors = torch.load(file)
    tensors["traj_2d"][:, 0] = WIDTH - 0.9
    tensors["verts_inds_vis"][:] = True
    torch.save(tensors, file)
    after = read_dataset(tmp_path)[SEQUENCE]
    assert after.occluded[:, 4].all()
    assert not before.occluded[:, 4].all()


def test_frames_of_a_sequence_are_the_first_300(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dynamic_replica, "FRAMES", 12)
    write_dynamic_replica(tmp_path)
    assert read_dataset(tmp_path)[SEQUENCE].num_frames == 12


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"sequence_name": None}, "must name the sequence"),
        ({"trajectories": None}, "a path below its folder as trajectories"),
        ({"image": {"path": "/etc/passwd"}}, "a path below its folder as image"),
        ({"image": {"path": "a/../../b.png"}}, "a path below its folder as image"),
        ({"camera_name": "right"}, "no frame of the left camera"),
    ],
)
def test_annotations_that_do_not_fit_are_named(change: dict[str, Any], words: str, tmp_path: Path) -> None:
    write_dynamic_replica(tmp_path)
    write_annotations(tmp_path, [{**entry, **change} for entry in entries(tmp_path)])
    with pytest.raises(DatasetError, match=words):
        read_dataset(tmp_path)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"no gzip", "cannot be read as gzipped JSON"),
        (gzip.compress(b"no json"), "cannot be read as gzipped JSON"),
        (gzip.compress(b"[" * 100_000), "cannot be read as gzipped JSON"),
        (gzip.compress(b"[1]"), "must be a list of frames"),
        (gzip.compress(b"[]"), "no frame of the left camera"),
    ],
    ids=["no gzip", "no json", "deep", "a number", "empty"],  # of the same name on all workers: gzip keeps the time
)
def test_damaged_annotations(content: bytes, words: str, tmp_path: Path) -> None:
    (tmp_path / "frame_annotations_test.jgz").write_bytes(content)
    with pytest.raises(DatasetError, match=words):
        read_dataset(tmp_path)


def test_annotations_of_two_splits_are_refused(tmp_path: Path) -> None:
    for split in ("valid", "test"):
        (tmp_path / f"frame_annotations_{split}.jgz").write_bytes(b"")
    with pytest.raises(DatasetError, match="must have one frame_annotations"):
        read_dataset(tmp_path)


@pytest.mark.parametrize(
    ("tensors", "words"),
    [
        ({"verts_inds_vis": None}, "must have the tensors traj_2d and verts_inds_vis"),
        ({"traj_2d": (8, 3)}, r"N = 7 as in the sequence's first frame, not \[8, 3\] and \[7\]"),
        ({"traj_2d": (7, 1)}, r"not \[7, 1\] and \[7\]"),
        ({"traj_2d": (7,)}, "numbers with 2 axes as traj_2d"),
    ],
)
def test_trajectories_that_do_not_fit_are_named(tensors: dict[str, Any], words: str, tmp_path: Path) -> None:
    import torch

    write_dynamic_replica(tmp_path)
    file = tmp_path / entries(tmp_path)[1]["trajectories"]["path"]
    content = torch.load(file)
    content |= {key: None if shape is None else torch.zeros(shape) for key, shape in tensors.items()}
    torch.save({key: value for key, value in content.items() if value is not None}, file)
    with pytest.raises(DatasetError, match=words):
        read_dataset(tmp_path)[SEQUENCE]


def test_a_file_that_would_run_code_is_refused(tmp_path: Path) -> None:
    import torch

    class Evil:
        def __reduce__(self) -> tuple[Any, ...]:
            return Path.touch, (tmp_path / "executed",)

    write_dynamic_replica(tmp_path)
    torch.save({"traj_2d": Evil()}, tmp_path / entries(tmp_path)[1]["trajectories"]["path"])
    with pytest.raises(UnsafePickleError, match="nothing in it executed"):
        read_dataset(tmp_path)[SEQUENCE]
    assert not (tmp_path / "executed").exists()


def changed(root: Path, number: int, **tensors: Any) -> None:
    """Other values of one frame's tensors."""
    import torch

    file = root / entries(root)[number]["trajectories"]["path"]
    torch.save(torch.load(file) | {key: torch.tensor(values) for key, values in tensors.items()}, file)


def test_its_own_numbers() -> None:
    assert (dynamic_replica.FRAMES, dynamic_replica.POINTS) == (300, 256)


@pytest.mark.parametrize(
    ("place", "seen"),
    [
        ((0.0, 0.0), True),
        ((WIDTH - 1.0, HEIGHT - 1.0), True),
        ((-0.1, 9.0), False),
        ((9.0, -0.1), False),
        ((WIDTH - 0.9, 9.0), False),
        ((9.0, HEIGHT - 0.9), False),
    ],
)
def test_points_are_seen_from_0_to_the_last_pixel(place: tuple[float, float], seen: bool, tmp_path: Path) -> None:
    truth = write_dynamic_replica(tmp_path)
    xy = np.tile(np.float32([*place, 1]), (7, 1))
    changed(tmp_path, 4, traj_2d=xy, verts_inds_vis=np.ones(7, bool))
    video = read_dataset(tmp_path)[SEQUENCE]
    assert len(video.occluded) >= (truth["visible"].sum(axis=0) > 11).sum()
    assert (video.occluded[:, 4] != seen).all()


def test_points_are_kept_that_are_seen_in_eleven_frames(tmp_path: Path) -> None:
    """Of thirteen; where one is hidden its place need not be known."""
    truth = write_dynamic_replica(tmp_path)
    for number in range(FRAMES):
        visible = np.array([True, number > 1, number > 2, number > 3, True, True, True])
        xy = np.column_stack([truth["xy"][number], np.ones(7)]).astype(np.float32)
        xy[~visible] = np.nan
        changed(tmp_path, number, traj_2d=xy, verts_inds_vis=visible)
    video = read_dataset(tmp_path)[SEQUENCE]
    assert (~video.occluded).sum(axis=1).tolist() == [13, 11, 13, 13, 13]


def test_all_frames_have_as_many_points_as_the_first(tmp_path: Path) -> None:
    write_dynamic_replica(tmp_path)
    changed(tmp_path, 1, traj_2d=np.zeros((8, 3)), verts_inds_vis=np.ones(8, bool))
    with pytest.raises(DatasetError, match=r"N = 7 as in the sequence's first frame, not \[8, 3\] and \[8\]"):
        read_dataset(tmp_path)[SEQUENCE]


def test_frames_of_other_cameras_are_left_out(tmp_path: Path) -> None:
    write_dynamic_replica(tmp_path)
    before = read_dataset(tmp_path)[SEQUENCE]
    known = [entry for entry in entries(tmp_path) if entry["camera_name"] == "left"]
    others = [{**known[0], "camera_name": name} for name in ("right", "top")]
    write_annotations(tmp_path, [*others, *known, {key: known[0][key] for key in known[0] if key != "camera_name"}])
    after = read_dataset(tmp_path)[SEQUENCE]
    np.testing.assert_array_equal(after.points, before.points)
    assert after.num_frames == before.num_frames

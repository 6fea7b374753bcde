"""PointOdyssey: which points are asked for, and where they are valid, as PIPs++'s reader has it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dataset_files import FRAMES, HEIGHT, WIDTH, walks, write_pointodyssey
from decomo_eval.dataset import read_dataset
from decomo_eval.errors import DatasetError
from decomo_eval.tapvid import sample_queries
from decomo_eval.video import Video
from near_misses import npz

SCENE = "r5_new_f"


def scene(root: Path) -> Video:
    return read_dataset(root)[SCENE]


def test_a_scene(tmp_path: Path) -> None:
    truth = write_pointodyssey(tmp_path)
    video = scene(tmp_path)
    seen = truth["visibs"].sum(axis=0) >= 8
    np.testing.assert_allclose(video.points * [WIDTH, HEIGHT], truth["trajs_2d"].swapaxes(0, 1)[seen], rtol=1e-6)
    np.testing.assert_array_equal(video.occluded, ~truth["visibs"].T[seen])
    assert video.judged is None
    assert video.frames().shape == (FRAMES, HEIGHT, WIDTH, 3)
    assert (sample_queries(video, "first").points[:, 0] == 0).all()


def test_its_first_release(tmp_path: Path) -> None:
    truth = write_pointodyssey(tmp_path)
    code = truth["visibs"].astype(np.uint8)
    code[2] = 2
    np.savez(tmp_path / SCENE / "annotations.npz", trajs_2d=truth["trajs_2d"], visibilities=code)
    (tmp_path / SCENE / "anno.npz").unlink()
    video = scene(tmp_path)
    seen = (code == 1).sum(axis=0) >= 8
    np.testing.assert_array_equal(video.occluded, (code != 1).T[seen])
    assert video.figures is not None
    far = video.points * 256
    far[:, 2] += 400  # not valid: nobody minds
    assert video.figures(far, video.occluded)["pointodyssey_d_avg"] == 1
    far[:, 3] += 400
    assert video.figures(far, video.occluded)["pointodyssey_d_avg"] < 1


def test_points_that_are_not_good_are_left_out(tmp_path: Path) -> None:
    xy, visible, valid = walks(6), np.ones((FRAMES, 6), bool), np.ones((FRAMES, 6), bool)
    visible[0, 0] = False
    valid[0, 1] = False
    visible[7:, 2] = False  # seen in seven frames
    visible[8:, 3] = False  # in eight
    xy[0, 4] = WIDTH - 1.9, 5  # nearer than a pixel to the last one's centre
    xy[4, 5] = np.nan
    write_pointodyssey(tmp_path, trajs_2d=xy, visibs=visible, valids=valid)
    video = scene(tmp_path)
    np.testing.assert_allclose(video.points[:, 0] * [WIDTH, HEIGHT], xy[0, [3, 5]], rtol=1e-6)
    assert video.occluded[1].tolist() == [frame == 4 for frame in range(FRAMES)]


def test_a_point_outside_is_not_valid(tmp_path: Path) -> None:
    xy = walks(1)
    xy[5, 0] = WIDTH + 90, 5
    write_pointodyssey(tmp_path, trajs_2d=xy, visibs=np.ones((FRAMES, 1), bool), valids=np.ones((FRAMES, 1)))
    video = scene(tmp_path)
    assert video.occluded[0, 5]
    np.testing.assert_allclose(video.points[0, 5] * WIDTH, [WIDTH + 32, 5 * WIDTH / HEIGHT])
    assert video.figures is not None
    tracks = video.points * 256
    tracks[0, 5] = 0
    assert video.figures(tracks, video.occluded)["pointodyssey_survival"] == 1


def test_of_many_points_256_are_asked_for(tmp_path: Path) -> None:
    xy = walks(1000)
    write_pointodyssey(tmp_path, trajs_2d=xy, visibs=np.ones((FRAMES, 1000)), valids=np.ones((FRAMES, 1000)))
    inside = ((xy[0] >= 1) & (xy[0] <= [WIDTH - 2, HEIGHT - 2])).all(axis=1)
    assert inside.all()
    rows = np.linspace(0, 999, 256).astype(np.int32)
    np.testing.assert_allclose(scene(tmp_path).points[:, 0] * [WIDTH, HEIGHT], xy[0, rows], rtol=1e-6)


def test_annotations_beyond_the_frames_are_not_read(tmp_path: Path) -> None:
    truth = write_pointodyssey(tmp_path)
    whole = scene(tmp_path)
    longer = {key: np.concatenate([array, array[:4]]) for key, array in truth.items()}
    (tmp_path / SCENE / "anno.npz").write_bytes(npz(longer))
    np.testing.assert_array_equal(scene(tmp_path).points, whole.points)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"valids": None}, "lacks the array valids"),
        ({"visibs": np.full((FRAMES, 9), 3)}, "only true and false in visibs"),
        ({"visibs": np.ones((FRAMES, 8))}, "as many points in each array"),
        ({"visibs": np.ones((FRAMES - 1, 9))}, f"in each of {FRAMES} frames"),
        ({"trajs_2d": np.zeros((FRAMES, 9, 3))}, r"must have trajs_2d \[T, N, 2\]"),
        ({"trajs_2d": np.zeros((FRAMES, 9))}, "numbers with 3 axes as trajs_2d"),
        ({"trajs_2d": np.array([[["a", "b"]]])}, "numbers with 3 axes as trajs_2d"),
        ({"trajs_2d": np.array([None])}, "is not an .npz file of plain arrays"),
    ],
)
def test_what_does_not_fit_is_named(changed: dict[str, Any], words: str, tmp_path: Path) -> None:
    write_pointodyssey(tmp_path, **changed)
    with pytest.raises(DatasetError, match=words):
        scene(tmp_path)


@pytest.mark.parametrize(
    ("place", "valid"),
    [
        ((1.0, 1.0), True),
        ((WIDTH - 2.0, HEIGHT - 2.0), True),
        ((0.9, 9.0), False),
        ((9.0, 0.9), False),
        ((WIDTH - 1.9, 9.0), False),
        ((9.0, HEIGHT - 1.9), False),
    ],
)
def test_places_are_valid_a_pixel_inside(place: tuple[float, float], valid: bool, tmp_path: Path) -> None:
    xy = walks(1)
    xy[3, 0] = place
    write_pointodyssey(tmp_path, trajs_2d=xy, visibs=np.ones((FRAMES, 1), bool), valids=np.ones((FRAMES, 1)))
    video = scene(tmp_path)
    assert video.occluded[0].tolist() == [frame == 3 and not valid for frame in range(FRAMES)]


def test_a_place_far_to_the_upper_left_is_brought_to_32_pixels_outside(tmp_path: Path) -> None:
    xy = walks(1)
    xy[5, 0] = -90, -33
    write_pointodyssey(tmp_path, trajs_2d=xy, visibs=np.ones((FRAMES, 1), bool), valids=np.ones((FRAMES, 1)))
    np.testing.assert_allclose(scene(tmp_path).points[0, 5] * [WIDTH, HEIGHT], [-32, -32])


def test_of_both_releases_the_later_is_read(tmp_path: Path) -> None:
    truth = write_pointodyssey(tmp_path)
    expected = scene(tmp_path).points
    code = truth["visibs"].astype(np.uint8)
    np.savez(tmp_path / SCENE / "annotations.npz", trajs_2d=truth["trajs_2d"] + 1, visibilities=code)
    np.testing.assert_array_equal(scene(tmp_path).points, expected)


def test_scenes_are_in_alphabetic_order_without_hidden_ones(tmp_path: Path) -> None:
    for scene in ("scene_b", ".scene_c", "scene_a", "scene_d"):
        write_pointodyssey(tmp_path, scene)
    assert list(read_dataset(tmp_path)) == ["scene_a", "scene_b", "scene_d"]

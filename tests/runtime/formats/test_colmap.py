"""COLMAP's database, as COLMAP itself reads and maps it."""

from __future__ import annotations

import sqlite3
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from consumers import consumer
from decomo_runtime import About, TracksFileError
from decomo_runtime.convert_cli import main
from known_tracks import HEIGHT, WIDTH, known_tracks
from parallax import FOCAL, journey


@pytest.fixture(scope="module")
def pycolmap() -> Any:
    return consumer("pycolmap")


def mapped(pycolmap: Any, database: Path, folder: Path) -> Any:
    """The largest reconstruction."""
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads, options.extract_colors = 1, False
    models = pycolmap.incremental_mapping(str(database), str(folder), str(folder / "models"), options)
    return max(models.values(), key=lambda model: model.num_reg_images())


def camera_places(model: Any) -> np.ndarray:
    images = sorted((image for image in model.images.values() if image.has_pose), key=lambda image: image.name)
    return np.array([image.projection_center() for image in images])


class TestDatabase:
    @pytest.fixture
    def database(self, pycolmap: Any, tmp_path: Path) -> Any:
        tracks = journey(first=3).tracks
        xy, occluded = tracks.xy.copy(), tracks.occluded.copy()
        xy[0], occluded[0] = (10.25, 20.5), False
        xy[0, 0], xy[0, 1], occluded[0, 2] = (0, 0), (639, 359), True
        replace(tracks, xy=xy, occluded=occluded).save(tmp_path / "a.db")
        assert [file.name for file in tmp_path.iterdir()] == ["a.db"]
        with pycolmap.Database.open(str(tmp_path / "a.db")) as opened:
            yield opened

    def test_images_are_frames(self, database: Any):
        images = sorted(database.read_all_images(), key=lambda image: image.image_id)
        assert [image.name for image in images] == [f"{number:05}.png" for number in range(4, 16)]  # ffmpeg's, from 1
        assert {image.camera_id for image in images} == {1}

    def test_camera(self, database: Any):
        (camera,) = database.read_all_cameras()
        assert (camera.width, camera.height, camera.model.name) == (WIDTH, HEIGHT, "SIMPLE_RADIAL")
        assert camera.params.tolist() == [1.2 * 640, 320, 180, 0]
        assert not camera.has_prior_focal_length

    def test_pixels(self, database: Any):
        first = [database.read_keypoints(number + 1)[0, :2].tolist() for number in (0, 1, 3)]
        assert first == [[0.5, 0.5], [639.5, 359.5], [10.75, 21]]

    def test_keypoints_are_the_points_in_sight_and_matches_join_the_same(self, database: Any):
        tracks = journey(first=3).tracks
        for a, b in ((0, 1), (2, 4), (3, 7), (0, 8)):
            common = ~tracks.occluded[1:, a] & ~tracks.occluded[1:, b]
            left, right = database.read_matches(a + 1, b + 1).T
            ours = tracks.xy[1:][common] + 0.5
            kept = ~np.isin(left, [0]) | (a == 2)  # the point with places of its own
            np.testing.assert_array_equal(database.read_keypoints(a + 1)[left[kept], :2], ours[:, a])
            kept = ~np.isin(right, [0]) | (b == 2)
            np.testing.assert_array_equal(database.read_keypoints(b + 1)[right[kept], :2], ours[:, b])

    def test_pairs(self, database: Any):
        pairs = sum(12 - gap for gap in (1, 2, 3, 4, 6, 8))
        assert database.num_matched_image_pairs() == pairs
        assert database.num_inlier_matches() > 0.9 * database.num_matches()


def test_it_is_a_database_of_sqlite(pycolmap: Any, tmp_path: Path):
    journey().tracks.save(tmp_path / "a.db")
    with sqlite3.connect(tmp_path / "a.db") as database:
        tables = {name for (name,) in database.execute("select name from sqlite_master where type = 'table'")}
    database.close()
    assert {"cameras", "images", "keypoints", "matches", "two_view_geometries"} <= tables


@pytest.mark.parametrize("movers", [0, 40])
def test_colmap_finds_the_camera_s_way_and_its_focal_length(pycolmap: Any, tmp_path: Path, movers: int):
    known = journey(movers=movers)
    known.tracks.save(tmp_path / "a.db")
    model = mapped(pycolmap, tmp_path / "a.db", tmp_path)
    assert model.num_reg_images() == 12
    assert model.compute_mean_reprojection_error() < 0.2  # px; places are exact but for float32
    found = camera_places(model)
    likeness = pycolmap.estimate_sim3d(found, known.centres)
    placed = likeness.scale * found @ likeness.rotation.matrix().T + likeness.translation
    np.testing.assert_allclose(placed, known.centres, atol=0.02)  # of a way of 2.4
    (camera,) = model.cameras.values()
    np.testing.assert_allclose(camera.params[0], FOCAL, rtol=0.02)  # was guessed as 768
    assert model.num_points3D() >= 0.9 * (150 - movers)


def test_pixels_that_are_not_square(pycolmap: Any, tmp_path: Path):
    known = journey(aspect=1.5)
    known.tracks.save(tmp_path / "a.db", about=About(pixel_aspect=1.5))
    with pycolmap.Database.open(str(tmp_path / "a.db")) as database:
        (camera,) = database.read_all_cameras()
    assert camera.model.name == "OPENCV"
    assert camera.params.tolist() == [512, 768, 320, 180, 0, 0, 0, 0]
    model = mapped(pycolmap, tmp_path / "a.db", tmp_path)
    assert model.num_reg_images() == 12
    (camera,) = model.cameras.values()
    np.testing.assert_allclose(camera.params[:2], [FOCAL / 1.5, FOCAL], rtol=0.02)


def test_images_have_the_names_of_the_clip_s_frames(pycolmap: Any, tmp_path: Path):
    clip = tmp_path / "clip"
    clip.mkdir()
    for number in range(13):
        cv2.imwrite(str(clip / f"shot_{number + 7}.jpg"), np.zeros((HEIGHT, WIDTH, 3), np.uint8))
    journey().tracks.save(tmp_path / "tracks.npz")
    assert main([str(tmp_path / "tracks.npz"), str(tmp_path / "a.db"), "--clip", f"{clip}@1:13"]) == 0
    with pycolmap.Database.open(str(tmp_path / "a.db")) as database:
        names = [image.name for image in database.read_all_images()]
    assert sorted(names) == sorted(f"shot_{number}.jpg" for number in range(8, 20))


def test_too_few_points_are_refused(pycolmap: Any, tmp_path: Path):
    with pytest.raises(TracksFileError, match="COLMAP wants 15 points in sight in two frames, but there are 3; follow"):
        known_tracks().save(tmp_path / "a.db")
    few = journey(frames=3).tracks
    occluded = few.occluded.copy()
    occluded[14:, 1:] = True
    with pytest.raises(TracksFileError, match="COLMAP wants 15 points in sight in two frames, but no two have them"):
        replace(few, occluded=occluded).save(tmp_path / "a.db")
    with pytest.raises(TracksFileError, match="no two frames whose points move as those of a static scene"):
        journey(points=20, frames=2, movers=20).tracks.save(tmp_path / "a.db")
    with pytest.raises(TracksFileError, match="do not say the clip's size"):
        replace(journey().tracks, size=None).save(tmp_path / "a.db")
    assert not list(tmp_path.iterdir())

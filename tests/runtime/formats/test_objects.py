"""Points of several objects, by their names, in the formats that know objects."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from consumers import consumer
from decomo_runtime import About
from decomo_runtime.formats.objects import objects_of
from decomo_runtime.keypoints import read_keypoints
from known_tracks import known_tracks

MICE = About(points=("a.nose", "b.nose", "a.tail"), name="mouse")
"""Of the known tracks: "corner" is a's nose, "late" is b's, and a's tail, at (100, 100), is never in sight."""


@pytest.mark.parametrize(
    ("points", "names", "parts", "rows"),
    [
        (MICE.points, ["a", "b"], ["nose", "tail"], [[0, 2], [1, -1]]),
        (("a.nose", "a.tail", "a.ear"), ["mouse"], ["a.nose", "a.tail", "a.ear"], [[0, 1, 2]]),
        (("a.nose", "b.nose", "tail"), ["mouse"], ["a.nose", "b.nose", "tail"], [[0, 1, 2]]),
        (("a.1", "b.2", "c.3"), ["mouse"], ["a.1", "b.2", "c.3"], [[0, 1, 2]]),  # nothing in common
        (("a.", "b.", "c."), ["mouse"], ["a.", "b.", "c."], [[0, 1, 2]]),
        ((".n", "b.n", "c.n"), ["mouse"], [".n", "b.n", "c.n"], [[0, 1, 2]]),
        (("a.n", "a.n", "b.n"), ["a", "b"], ["n", "n_2"], [[0, 1], [2, -1]]),
        ((), ["mouse"], ["point_00", "point_01", "point_02"], [[0, 1, 2]]),
    ],
)
def test_objects(points: tuple[str, ...], names: list[str], parts: list[str], rows: list[list[int]]):
    found = objects_of(About(points=points, name="mouse"), 3)
    assert (found.names, found.parts, found.rows.tolist()) == (names, parts, rows)
    assert found.several == (len(names) > 1)


@pytest.mark.parametrize(("points", "several"), [(("a.1", "b.2"), True), (("a.1", "b.2", "c.2", "c.3"), False)])
def test_objects_have_half_of_the_parts_at_least(points: tuple[str, ...], several: bool):
    """Two of four places are filled; and four of nine."""
    assert objects_of(About(points=points), len(points)).several == several


@pytest.mark.parametrize("ending", [".csv", ".h5"])
def test_deeplabcut(tmp_path: Path, ending: str):
    if ending == ".h5":
        consumer("tables")
    path = tmp_path / f"a{ending}"
    known_tracks().save(path, "deeplabcut", about=MICE)
    keypoints = read_keypoints(path)
    assert keypoints.names == ("a.nose", "a.tail", "b.nose", "b.tail")
    np.testing.assert_array_equal(keypoints.xy[:, 3], [[319.5, 179.5], [100, 100], [1, 2], [np.nan, np.nan]])
    np.testing.assert_array_equal(keypoints.score[:, 3], [1, 0, 1, 0])


@pytest.mark.parametrize("ending", [".csv", ".h5", ".slp"])
def test_movement_reads_individuals(tmp_path: Path, ending: str):
    load = consumer("movement.io.load_poses")
    path = tmp_path / f"a{ending}"
    known_tracks().save(path, "sleap" if ending == ".slp" else "deeplabcut", about=MICE)
    poses = load.from_sleap_file(path) if ending == ".slp" else load.from_dlc_file(path)
    assert poses.individuals.values.tolist() == ["a", "b"]
    assert poses.keypoints.values.tolist() == ["nose", "tail"]
    noses = poses.position.sel(keypoints="nose")
    np.testing.assert_array_equal(noses.sel(individuals="a").values[3], [319.5, 179.5])
    np.testing.assert_array_equal(noses.sel(individuals="b").values[4], [3, 4.5])
    assert np.isnan(poses.position.sel(individuals="b", keypoints="tail").values).all()


def test_sleap(tmp_path: Path):
    sio = consumer("sleap_io")
    known_tracks().save(tmp_path / "a.slp", about=MICE)
    labels = sio.load_slp(str(tmp_path / "a.slp"), open_videos=False)
    assert [track.name for track in labels.tracks] == ["a", "b"]
    a, b = labels[3].instances
    assert (a.track.name, b.track.name) == ("a", "b")
    np.testing.assert_array_equal(a.numpy(), [[319.5, 179.5], [np.nan, np.nan]])
    np.testing.assert_array_equal(b.numpy(), [[1, 2], [np.nan, np.nan]])
    np.testing.assert_array_equal(a["tail"]["xy"], [100, 100])


def test_coco(tmp_path: Path):
    known_tracks().save(tmp_path / "a.json", "coco", about=MICE)
    content = json.loads((tmp_path / "a.json").read_text())
    (category,) = content["categories"]
    assert category["keypoints"] == ["nose", "tail"]
    annotations = content["annotations"]
    assert [each["id"] for each in annotations] == list(range(1, 11))
    assert [(each["image_id"], each["track_id"]) for each in annotations[6:8]] == [(4, 1), (4, 2)]
    assert [each["keypoints"] for each in annotations[6:8]] == [[319.5, 179.5, 2, 100, 100, 1], [1, 2, 2, 0, 0, 0]]
    keypoints = read_keypoints(tmp_path / "a.json")
    assert keypoints.names == ("mouse1.nose", "mouse1.tail", "mouse2.nose", "mouse2.tail")


def test_mot(tmp_path: Path):
    known_tracks().save(tmp_path / "a.txt", "mot", about=MICE)
    lines = (tmp_path / "a.txt").read_text().splitlines()
    assert len(lines) == 10
    assert lines[6:8] == ["4,1,101.00,101.00,220.50,80.50,1,1,0.5000", "4,2,2.00,3.00,1.00,1.00,1,1,1.0000"]

"""napari's table of tracks, and the plugin with which it opens ours, without a window."""

from __future__ import annotations

import tomllib
import warnings
from collections.abc import Iterator
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from consumers import consumer
from decomo_runtime import About, ModelFileError, TracksFileError
from decomo_runtime.napari_reader import POINTS, get_reader
from known_tracks import HIDDEN, NUM_FRAMES, PLACES, known_tracks

CORNER = [[0, frame, *PLACES["corner"].get(frame, HIDDEN)[::-1]] for frame in range(NUM_FRAMES)]
"""(track_id, t, y, x)."""
PROJECT = Path(__file__).parents[3] / "pyproject.toml"


@pytest.fixture
def napari() -> Iterator[Any]:
    """What napari warns of by itself is not ours."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        consumer("napari.components")
        yield consumer("napari")


@pytest.fixture
def viewer(napari: Any) -> Any:
    """One without a window, that has our plugin."""
    npe2 = consumer("npe2")
    manager = npe2.PluginManager.instance()
    if "decomotion" not in manager:
        manager.register(npe2.PluginManifest.from_file(str(files("decomo_runtime") / "napari.yaml")))
    return napari.components.ViewerModel()


def test_the_table_is_a_layer_s_data(tmp_path: Path, napari: Any):
    known_tracks().save(tmp_path / "a.csv", "napari")
    table = np.loadtxt(tmp_path / "a.csv", delimiter=",", skiprows=1)
    layer = napari.layers.Tracks(table[:, :4], features={"occlusion": table[:, 4], "occluded": table[:, 5]})
    np.testing.assert_array_equal(layer.data[:NUM_FRAMES], CORNER)
    assert layer.features["occluded"][:NUM_FRAMES].tolist() == [0, 0, 1, 0, 0]


def test_its_first_lines(tmp_path: Path):
    known_tracks().save(tmp_path / "a.csv", "napari", about=About(first_frame=10))
    lines = (tmp_path / "a.csv").read_text().splitlines()
    assert lines[:3] == [
        "track_id,t,y,x,occlusion,occluded",
        "0,10,0.0000,0.0000,0.0000,0",
        "0,11,359.0000,639.0000,0.0000,0",
    ]
    assert len(lines) == 1 + 15


def test_how_far_off_a_point_may_be(tmp_path: Path, viewer: Any):
    tracks = known_tracks()
    error = np.zeros_like(tracks.occlusion)
    error[0] = [0, 1.5, 40, 2.25, 3]
    tracks = replace(tracks, error=error)
    tracks.save(tmp_path / "a.npz")
    (layer,) = viewer.open(str(tmp_path / "a.npz"), plugin="decomotion")
    assert layer.features["error"][:NUM_FRAMES].tolist() == [0, 1.5, 40, 2.25, 3]
    layer.color_by = "error"
    tracks.save(tmp_path / "a.csv", "napari")
    lines = (tmp_path / "a.csv").read_text().splitlines()
    assert lines[0] == "track_id,t,y,x,occlusion,occluded,error"
    assert lines[2] == "0,1,359.0000,639.0000,0.0000,0,1.5000"


@pytest.mark.parametrize("name", ["a.npz", "a.csv", "a.json"])
def test_napari_opens_tracks(tmp_path: Path, viewer: Any, name: str):
    known_tracks().save(tmp_path / name)
    (layer,) = viewer.open(str(tmp_path / name), plugin="decomotion")
    assert type(layer).__name__ == "Tracks"
    np.testing.assert_array_equal(layer.data[:NUM_FRAMES], CORNER)
    assert layer.features["occluded"][:NUM_FRAMES].tolist() == [0, 0, 1, 0, 0]
    assert viewer.dims.range[0] == (0, NUM_FRAMES - 1, 1)


def test_napari_opens_a_model(model_path: Path, viewer: Any):
    (layer,) = viewer.open(str(model_path), plugin="decomotion")
    assert layer.name == "slide"
    assert set(layer.data[:, 1]) == {0, 1, 2, 3, 4, 5}
    assert 100 < len(set(layer.data[:, 0])) <= POINTS
    start = layer.data[layer.data[:, 1] == 3]
    assert start[:, 2].min() >= 0
    assert start[:, 2].max() <= 39  # of 40 rows and 48 columns
    assert 40 < start[:, 3].max() <= 47


class TestReader:
    def test_a_layer(self, tmp_path: Path):
        known_tracks().save(tmp_path / "goat.npz")
        read = get_reader(str(tmp_path / "goat.npz"))
        assert read is not None
        ((data, options, kind),) = read(str(tmp_path / "goat.npz"))
        assert kind == "tracks"
        assert options["name"] == "goat"
        assert options["metadata"]["size"] == (360, 640)
        assert len(data) == 15

    def test_several(self, tmp_path: Path):
        for name in ("a.npz", "b.npz"):
            known_tracks().save(tmp_path / name)
        read = get_reader([str(tmp_path / "a.npz"), str(tmp_path / "b.npz")])
        assert read is not None
        assert [options["name"] for _, options, _ in read("")] == ["a", "b"]

    @pytest.mark.parametrize(("sized", "vertices"), [(True, 9), (False, 10)])
    def test_there_is_no_vertex_nowhere_and_none_beyond_a_known_frame(self, tmp_path: Path, sized: bool, vertices: int):
        tracks = known_tracks(sized=sized)
        xy = tracks.xy.copy()
        xy[2] = np.nan
        xy[1, 0] = -0.6, 100
        replace(tracks, xy=xy).save(tmp_path / "a.npz")
        read = get_reader(str(tmp_path / "a.npz"))
        assert read is not None
        assert len(read("")[0][0]) == vertices

    def test_tracks_that_are_nowhere_are_left_alone(self, tmp_path: Path):
        tracks = known_tracks()
        nowhere = replace(tracks, xy=tracks.xy * np.nan, occluded=np.ones_like(tracks.occluded))
        nowhere.save(tmp_path / "a.npz")
        assert get_reader(str(tmp_path / "a.npz")) is None
        with pytest.raises(TracksFileError, match="no point is in the frame at any time"):
            nowhere.save(tmp_path / "a.csv", "napari")

    def test_what_is_not_ours_is_left_to_others(self, tmp_path: Path):
        (tmp_path / "points.csv").write_text("index,axis-0,axis-1\n0,1,2\n")
        np.savez(tmp_path / "a.npz", a=np.zeros(3))
        (tmp_path / "a.json").write_text("{}")
        for name in ("points.csv", "a.npz", "a.json", "none.npz", "."):
            assert get_reader(str(tmp_path / name)) is None

    def test_a_damaged_model_is_told(self, tmp_path: Path):
        (tmp_path / "a.onnx").write_bytes(b"no model")
        read = get_reader(str(tmp_path / "a.onnx"))
        assert read is not None
        with pytest.raises(ModelFileError):
            read(str(tmp_path / "a.onnx"))


def test_napari_finds_the_manifest():
    project = tomllib.loads(PROJECT.read_text())["project"]
    (value,) = project["entry-points"]["napari.manifest"].values()
    package, _, name = value.partition(":")
    assert (files(package) / name).is_file()
    assert f"name: {project['name']}\n" in (files(package) / name).read_text()

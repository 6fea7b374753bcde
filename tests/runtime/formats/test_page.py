"""The page's JSON, there and back."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from decomo_runtime import About, Tracks, TracksFileError, convert
from decomo_runtime.formats.page import check
from decomo_runtime.formats.registry import read
from known_tracks import known_tracks

ABOUT = About(name="goat", points=("Point 1", "Ohr ö", "x"), colours=("#f73e73", "#000000", "#ffffff"))


def saved(tmp_path: Path, **about: Any) -> Path:
    known_tracks().save(tmp_path / "a.json", about=replace(ABOUT, **about))
    return tmp_path / "a.json"


def test_round_trip(tmp_path: Path):
    tracks, about = read(saved(tmp_path))
    expected = known_tracks()
    for field in ("xy", "occluded", "occlusion", "queries", "frames", "times"):
        np.testing.assert_array_equal(getattr(tracks, field), getattr(expected, field))
        assert getattr(tracks, field).dtype == getattr(expected, field).dtype
    assert tracks.size == expected.size
    assert about == replace(ABOUT, fps=25, length=5)


def test_form(tmp_path: Path):
    content = json.loads(saved(tmp_path).read_text())
    assert content["format"] == "decomotion.points"
    assert content["version"] == 1
    assert content["clip"] == {"name": "goat", "num_frames": 5, "width": 640, "height": 360, "fps": 25}
    first = content["points"][0]
    assert list(first) == ["name", "colour", "t", "x", "y", "tracks", "occlusion", "occluded"]
    assert first["tracks"][4] == [10.25, 20.5]
    assert first["occluded"] == [False, False, True, False, False]
    assert [first[key] for key in ("name", "colour", "t", "x", "y")] == ["Point 1", "#f73e73", 0, 0, 0]


def test_names_reach_the_next_tool(tmp_path: Path):
    convert(saved(tmp_path), tmp_path / "a.txt", "3dequalizer")
    lines = (tmp_path / "a.txt").read_text().splitlines()
    assert (lines[1], lines[8]) == ("Point_1", "Ohr")


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: content.clear(),
        lambda content: content.update(format="other"),
        lambda content: content.update(points={"name": "x"}),
        lambda content: content["clip"].pop("width"),
        lambda content: content["clip"].update(num_frames=0),
        lambda content: content["clip"].update(num_frames=True),
        lambda content: content["clip"].update(height=True),
        lambda content: content["clip"].update(fps=0),
        lambda content: content["clip"].update(fps=float("nan")),
        lambda content: content["points"][1].pop("tracks"),
        lambda content: content["points"][1]["tracks"].pop(),
        lambda content: content["points"][1]["tracks"].__setitem__(0, [1]),
        lambda content: content["points"][1].update(x=float("inf")),
        lambda content: content["points"][1].update(x=10**400),
        lambda content: content["points"][1].update(occluded="no"),
    ],
)
def test_damage(tmp_path: Path, damage: Any):
    path = saved(tmp_path)
    content = json.loads(path.read_text())
    damage(content)
    path.write_text(json.dumps(content))
    with pytest.raises(TracksFileError, match="is not the JSON of points with their tracks"):
        Tracks.load(path)


@pytest.mark.parametrize("content", [b"", b"{", b"[" * 100_000, b"\xff", b"3", b"null"])
def test_no_json(tmp_path: Path, content: bytes):
    (tmp_path / "a.json").write_bytes(content)
    with pytest.raises(TracksFileError, match="is not the JSON of points"):
        Tracks.load(tmp_path / "a.json")


@pytest.mark.parametrize("version", [0, 2])
def test_another_version(tmp_path: Path, version: int):
    path = saved(tmp_path)
    path.write_text(path.read_text().replace('"version":1', f'"version":{version}'))
    with pytest.raises(TracksFileError, match=f"has version {version}, but this reads 1; upgrade"):
        Tracks.load(path)


def test_a_clip_without_a_name(tmp_path: Path):
    content = json.loads(saved(tmp_path).read_text())
    for name in ({"name": ""}, {}):
        content["clip"] = {key: value for key, value in content["clip"].items() if key != "name"} | name
        (tmp_path / "a.json").write_text(json.dumps(content))
        assert read(tmp_path / "a.json")[1].name == "clip"


def test_no_points(tmp_path: Path):
    tracks = known_tracks()
    none = Tracks(tracks.xy[:0], tracks.occluded[:0], tracks.occlusion[:0], tracks.queries[:0], tracks.frames)
    none.save(tmp_path / "a.json", about=About(size=(360, 640), fps=25))
    assert Tracks.load(tmp_path / "a.json").xy.shape == (0, 5, 2)


def test_what_the_page_does_not_take(tmp_path: Path):
    tracks = known_tracks()
    with pytest.raises(TracksFileError, match="holds all 6 frames of the clip in order"):
        tracks.save(tmp_path / "a.json", about=About(length=6))
    with pytest.raises(TracksFileError, match="do not say the clip's frame rate; give --fps"):
        known_tracks(timed=False).save(tmp_path / "a.json")
    many = 20_001
    crowd = Tracks(*(np.repeat(array[:1], many, axis=0) for array in (tracks.xy, tracks.occluded, tracks.occlusion)),
                   np.repeat(tracks.queries[:1], many, axis=0), tracks.frames, tracks.size, tracks.times)  # fmt: skip
    with pytest.raises(TracksFileError, match="takes 20000 points at once, but there are 20001"):
        crowd.save(tmp_path / "a.json")
    assert not list(tmp_path.iterdir())
    check(2000, tracks.frames, About())

"""rerun's recording, as `rerun-sdk` reads it."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from consumers import consumer
from decomo_runtime import About, Tracks
from known_tracks import FPS, HEIGHT, WIDTH, known_tracks

Row = dict[str, Any]


@pytest.fixture
def recorded(tmp_path: Path) -> Callable[..., tuple[Any, dict[str, dict[int, Row]]]]:
    """The reader of a recording, and its rows by entity and frame."""
    chunks = consumer("rerun.chunk")

    def write(tracks: Tracks | None = None, **about: Any) -> tuple[Any, dict[str, dict[int, Row]]]:
        (tracks or known_tracks()).save(tmp_path / "a.rrd", about=About(**about))
        reader = chunks.RrdReader(tmp_path / "a.rrd")
        entities: dict[str, dict[int, Row]] = {}
        for chunk in reader.stream():
            if "frame" in chunk.timeline_names:
                assert "log_time" not in chunk.timeline_names
                for row in chunk.to_record_batch().to_pylist():
                    entities.setdefault(chunk.entity_path, {})[row["frame"]] = row
        return reader, entities

    return write


def test_points_in_sight(recorded: Callable[..., tuple[Any, dict[str, dict[int, Row]]]]):
    _, entities = recorded(name="goat")
    places = {frame: row["Points2D:positions"] for frame, row in sorted(entities["/clip/in_sight"].items())}
    assert places == {
        0: [[0.5, 0.5]],  # the first pixel's centre
        1: [[639.5, 359.5]],
        2: [],
        3: [[320, 180], [1.5, 2.5]],
        4: [[10.75, 21], [3.5, 5]],
    }
    assert entities["/clip/in_sight"][3]["Points2D:labels"] == ["point_00", "point_01"]
    assert [row["time"] for _, row in sorted(entities["/clip/in_sight"].items())] == [
        np.timedelta64(round(1e9 * frame / FPS), "ns") for frame in range(5)
    ]


def test_points_that_are_hidden(recorded: Callable[..., tuple[Any, dict[str, dict[int, Row]]]]):
    tracks = known_tracks()
    xy = tracks.xy.copy()
    xy[2, 1] = np.nan
    _, entities = recorded(replace(tracks, xy=xy))
    hidden = entities["/clip/hidden"]
    assert [hidden[frame]["Points2D:labels"] for frame in (1, 2, 4)] == [
        ["point_01"],  # the other is nowhere
        ["point_00", "point_01", "point_02"],
        ["point_02"],
    ]
    assert hidden[1]["Points2D:positions"] == [[100.5, 100.5]]
    seen = entities["/clip/in_sight"][3]
    assert hidden[2]["Points2D:colors"][:2] == seen["Points2D:colors"]  # a point keeps its colour
    assert (hidden[2]["Points2D:radii"], seen["Points2D:radii"]) == ([1], [2.5])


def test_trails_join_what_is_in_sight(recorded: Callable[..., tuple[Any, dict[str, dict[int, Row]]]]):
    reader, entities = recorded()
    strips = {frame: row["LineStrips2D:strips"] for frame, row in sorted(entities["/clip/trails"].items())}
    assert strips[1] == [[[0.5, 0.5], [639.5, 359.5]]]
    assert strips[2] == strips[3] == []
    assert strips[4] == [[[320, 180], [10.75, 21]], [[1.5, 2.5], [3.5, 5]]]
    assert len(reader.blueprints()) == 1  # in it the steps of the frames before are seen too


def test_frames_are_in_order(recorded: Callable[..., tuple[Any, dict[str, dict[int, Row]]]]):
    tracks = known_tracks()
    assert tracks.times is not None
    columns = [4, 1, 4]
    turned = {name: getattr(tracks, name)[:, columns] for name in ("xy", "occluded", "occlusion")}
    _, entities = recorded(replace(tracks, **turned, frames=tracks.frames[columns], times=tracks.times[columns]))
    rows = entities["/clip/in_sight"]
    assert {frame: row["time"] for frame, row in rows.items()} == {
        1: np.timedelta64(round(1e9 / FPS), "ns"),
        4: np.timedelta64(round(4e9 / FPS), "ns"),
    }
    assert rows[1]["Points2D:positions"] == [[639.5, 359.5]]


def test_first_frame_names_and_colours(recorded: Callable[..., tuple[Any, dict[str, dict[int, Row]]]]):
    _, entities = recorded(first_frame=1001, points=("nose", "tail", "ear"), colours=("#ff0000", "#00ff80", "#000000"))
    row = entities["/clip/in_sight"][1004]
    assert row["Points2D:labels"] == ["nose", "tail"]
    assert row["Points2D:colors"] == [0xFF0000FF, 0x00FF80FF]


def test_frames_of_the_clip(recorded: Callable[..., tuple[Any, dict[str, dict[int, Row]]]], tmp_path: Path):
    clip = tmp_path / "clip"
    clip.mkdir()
    for number in range(6):
        cv2.imwrite(str(clip / f"{number}.png"), np.full((HEIGHT, WIDTH, 3), (40 * number, 128, 200), np.uint8))
    tracks = known_tracks()
    _, entities = recorded(replace(tracks, frames=tracks.frames + 1), clip=clip)
    assert sorted(entities["/clip"]) == [1, 2, 3, 4, 5]
    blob = np.array(entities["/clip"][3]["EncodedImage:blob"], np.uint8)
    picture = cv2.imdecode(blob.ravel(), cv2.IMREAD_COLOR)
    assert picture is not None
    assert picture.shape == (HEIGHT, WIDTH, 3)
    np.testing.assert_allclose(picture[100, 100], (120, 128, 200), atol=3)  # of a JPEG


def test_rerun_s_own_check(recorded: Callable[..., tuple[Any, dict[str, dict[int, Row]]]], tmp_path: Path):
    recorded(name="goat")
    command = [sys.executable, "-m", "rerun", "rrd", "verify", str(tmp_path / "a.rrd")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert "1 file verified without error" in done.stdout + done.stderr


def test_a_trail_has_its_point_s_colour(recorded: Callable[..., tuple[Any, dict[str, dict[int, Row]]]]):
    tracks = known_tracks()
    occluded = tracks.occluded.copy()
    occluded[0, 4] = True  # the second point alone has a step there
    _, entities = recorded(replace(tracks, occluded=occluded), colours=("#ff0000", "#00ff80", "#000000"))
    row = entities["/clip/trails"][4]
    assert row["LineStrips2D:strips"] == [[[1.5, 2.5], [3.5, 5]]]
    assert row["LineStrips2D:colors"] == [0x00FF80FF]

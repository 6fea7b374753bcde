"""The script in the real Blender, which is the module `bpy`, of this Python or of the one that a variable names."""

from __future__ import annotations

import json
import os
import runpy
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from decomo_runtime import About, Tracks, TracksFileError
from known_tracks import HEIGHT, NUM_FRAMES, WIDTH, known_tracks

PYTHON = os.environ.get("DECOMO_BLENDER_PYTHON", sys.executable)
RUNNER = """
import json, runpy, sys
import bpy
script, opened, times = sys.argv[1:]
for path in json.loads(opened):
    bpy.data.movieclips.load(path)
for _ in range(int(times)):
    runpy.run_path(script)
clip = bpy.data.movieclips[0]
print("ANSWER" + json.dumps({
    "clips": len(bpy.data.movieclips), "size": list(clip.size), "frame_start": clip.frame_start,
    "frames": clip.frame_duration, "pixel_aspect": clip.tracking.camera.pixel_aspect,
    "weights": [t.weight for t in clip.tracking.tracks],
    "tracks": {t.name: [[m.frame, list(m.co), m.mute] for m in t.markers] for t in clip.tracking.tracks},
}))
"""


@pytest.fixture(scope="module")
def bpy() -> str:
    """A Python that has `bpy`."""
    found = subprocess.run([PYTHON, "-c", "import bpy"], capture_output=True, timeout=120)
    if found.returncode:
        pytest.skip(f"{PYTHON} has no bpy: pip install bpy where there is one, and name it in DECOMO_BLENDER_PYTHON")
    return PYTHON


@pytest.fixture
def frames(tmp_path: Path) -> Path:
    folder = tmp_path / "shot"
    folder.mkdir()
    for number in range(NUM_FRAMES):
        cv2.imwrite(str(folder / f"{number:04d}.png"), np.full((HEIGHT, WIDTH, 3), 40 * number, np.uint8))
    return folder


def run(bpy: str, script: Path, opened: tuple[Path, ...] = (), times: int = 1) -> subprocess.CompletedProcess[str]:
    arguments = [str(script), json.dumps([str(path) for path in opened]), str(times)]
    return subprocess.run([bpy, "-c", RUNNER, *arguments], capture_output=True, text=True, timeout=300)


def answer(done: subprocess.CompletedProcess[str]) -> dict[str, Any]:
    assert done.returncode == 0, done.stderr
    return json.loads(next(line for line in done.stdout.splitlines() if line.startswith("ANSWER"))[6:])


def test_the_tracks_are_in_the_clip(bpy: str, tmp_path: Path, frames: Path):
    about = About(clip=frames, first_frame=101, pixel_aspect=1.5)
    tracks = known_tracks()
    error = np.zeros_like(tracks.occlusion)
    error[0, 1] = 10  # four units: the place is near the truth with 0.8
    replace(tracks, error=error).save(tmp_path / "tracks.py", about=about)
    found = answer(run(bpy, tmp_path / "tracks.py", times=2))
    assert (found["clips"], found["size"], found["frames"]) == (1, [WIDTH, HEIGHT], NUM_FRAMES)
    assert (found["frame_start"], found["pixel_aspect"]) == (101, 1.5)
    assert list(found["tracks"]) == ["point_00", "point_01"]
    np.testing.assert_allclose(found["weights"], [(0.8 + 3) / 4, 1], atol=1e-6)
    corner, late = found["tracks"].values()
    assert [(frame, mute) for frame, _, mute in corner] == [
        *((1, False), (2, False), (3, True), (4, False), (5, False), (6, True))
    ]
    places = np.array([place for _, place, mute in corner if not mute]) * (WIDTH, HEIGHT)
    np.testing.assert_allclose(places, [(0.5, 359.5), (639.5, 0.5), (320, 180), (10.75, 339)], atol=1e-4)  # float32
    assert [(frame, mute) for frame, _, mute in late] == [(3, True), (4, False), (5, False), (6, True)]


def test_a_track_of_the_same_name_is_replaced(bpy: str, tmp_path: Path, frames: Path):
    known_tracks().save(tmp_path / "first.py", about=About(clip=frames))
    moved = replace(known_tracks(), occluded=np.roll(known_tracks().occluded, 1, axis=1))
    moved.save(tmp_path / "second.py", about=About(clip=frames))
    both = tmp_path / "both.py"
    both.write_text("\n".join(f"exec(open({str(tmp_path / name)!r}).read())" for name in ("first.py", "second.py")))
    assert answer(run(bpy, both))["tracks"] == answer(run(bpy, tmp_path / "second.py"))["tracks"]


def test_without_a_path_the_open_clip_is_taken(bpy: str, tmp_path: Path, frames: Path):
    other = tmp_path / "other.png"
    cv2.imwrite(str(other), np.zeros((20, 30, 3), np.uint8))
    known_tracks().save(tmp_path / "tracks.py")
    found = answer(run(bpy, tmp_path / "tracks.py", opened=(frames / "0000.png", other)))
    assert list(found["tracks"]) == ["point_00", "point_01"]
    failed = run(bpy, tmp_path / "tracks.py", opened=(other,))
    assert failed.returncode
    assert "open one clip of 640 x 360 in the Movie Clip Editor" in failed.stderr


@dataclass
class Marker:
    frame: int
    co: tuple[float, float]
    mute: bool = False


class Markers(list[Marker]):
    def insert_frame(self, frame: int, co: tuple[float, float]) -> Marker:
        self.delete_frame(frame)
        self.append(Marker(frame, co))
        return self[-1]

    def delete_frame(self, frame: int) -> None:
        self[:] = [marker for marker in self if marker.frame != frame]


class Made(dict[str, SimpleNamespace]):
    """A clip's tracks; a new one has a marker in the frame in which it was made."""

    def new(self, name: str, frame: int) -> SimpleNamespace:
        self[name] = SimpleNamespace(weight=1.0, markers=Markers([Marker(frame, (0, 0))]))
        return self[name]


class StandIn:
    """As much of `bpy` as the script asks for, for where there is none: what it says of places needs no Blender."""

    def __init__(self, *sizes: tuple[int, int]) -> None:
        self.opened = [
            SimpleNamespace(
                size=size,
                frame_start=0,
                tracking=SimpleNamespace(tracks=Made(), camera=SimpleNamespace(pixel_aspect=0)),
            )
            for size in sizes
        ]
        self.loaded: list[str] = []

    def load(self, path: str, check_existing: bool) -> SimpleNamespace:
        assert check_existing
        self.loaded.append(path)
        return self.opened[0]

    def __iter__(self) -> Iterator[SimpleNamespace]:
        return iter(self.opened)

    def run(self, script: Path) -> SimpleNamespace:
        with pytest.MonkeyPatch.context() as patch:
            patch.setitem(sys.modules, "bpy", SimpleNamespace(data=SimpleNamespace(movieclips=self)))
            runpy.run_path(str(script))
        return self.opened[0]


def test_places_and_frames_without_blender(tmp_path: Path):
    """Shares of 640x360 from the bottom left, frames from 1; muted beside what is in sight, but not before frame 1."""
    tracks = known_tracks()
    occlusion = tracks.occlusion.copy()
    occlusion[0, [0, 1]] = 0.5, 0.1
    replace(tracks, occlusion=occlusion).save(tmp_path / "a.py", about=About(first_frame=101, pixel_aspect=1.5))
    clip = StandIn((WIDTH, HEIGHT)).run(tmp_path / "a.py")
    assert (clip.frame_start, clip.tracking.camera.pixel_aspect) == (101, 1.5)
    corner, late = clip.tracking.tracks.values()
    assert (corner.weight, late.weight) == (pytest.approx((0.5 + 0.9 + 1 + 1) / 4), 1)
    seen = {marker.frame: marker.co for marker in corner.markers if not marker.mute}
    places = {1: (0.5, 359.5), 2: (639.5, 0.5), 4: (320.0, 180.0), 5: (10.75, 339.0)}
    assert seen == {frame: pytest.approx((x / WIDTH, y / HEIGHT)) for frame, (x, y) in places.items()}
    assert sorted(marker.frame for marker in corner.markers if marker.mute) == [3, 6]
    assert sorted(marker.frame for marker in late.markers if marker.mute) == [3, 6]
    assert sorted(marker.frame for marker in late.markers) == [3, 4, 5, 6]


def test_which_clip_without_blender(tmp_path: Path, frames: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    known_tracks().save(tmp_path / "a.py", about=About(clip=Path(frames.name)))
    blender = StandIn((WIDTH, HEIGHT))
    blender.run(tmp_path / "a.py")
    assert blender.loaded == [str(frames / "0000.png")]  # Blender runs elsewhere
    known_tracks().save(tmp_path / "b.py")
    blender = StandIn((HEIGHT, WIDTH), (WIDTH, HEIGHT))
    blender.run(tmp_path / "b.py")
    assert [list(clip.tracking.tracks) for clip in blender.opened] == [[], ["point_00", "point_01"]]
    with pytest.raises(RuntimeError, match="open one clip of 640 x 360 in the Movie Clip Editor"):
        StandIn((WIDTH, HEIGHT), (WIDTH, HEIGHT)).run(tmp_path / "b.py")


def test_limits_of_blender(tmp_path: Path):
    tracks = known_tracks()
    with pytest.raises(TracksFileError, match="names have up to 63 characters; shorten aaaa"):
        tracks.save(tmp_path / "a.py", about=About(points=("a" * 64, "b", "c")))
    far = replace(tracks, frames=tracks.frames + 1_048_570)
    with pytest.raises(TracksFileError, match="counts up to frame 1048574 but the tracks reach 1048575"):
        far.save(tmp_path / "a.py")
    assert not list(tmp_path.iterdir())


def test_a_path_is_no_code(tmp_path: Path):
    folder = tmp_path / "it's\n__import__('os')"
    folder.mkdir()
    cv2.imwrite(str(folder / "0.png"), np.zeros((HEIGHT, WIDTH, 3), np.uint8))
    tracks: Tracks = known_tracks()
    tracks.save(tmp_path / "tracks.py", about=About(clip=folder))
    lines = (tmp_path / "tracks.py").read_text().splitlines()
    assert f"CLIP = {str(folder / '0.png')!r}" in lines

"""Disks that are full, for formats whose libraries crash, wait or leave half a file then."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import cv2
import numpy as np
import pytest

from consumers import consumer
from decomo_runtime import About, Tracks
from decomo_runtime.formats.registry import format_of
from full_disk import writes_end_at
from known_tracks import HEIGHT, WIDTH, wandering_tracks
from parallax import journey

FORMATS = {"a.db": "pycolmap", "a.h5": "tables", "a.slp": "sleap_io", "a.rrd": "rerun"}
"""Files, and the libraries that write them."""


@pytest.fixture(params=FORMATS)
def name(request: pytest.FixtureRequest) -> str:
    consumer(FORMATS[request.param])
    return request.param


def test_a_full_disk_is_told_and_nothing_is_left(tmp_path: Path, name: str):
    with writes_end_at(4096), pytest.raises(OSError, match=name):
        journey().tracks.save(tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_sqlite_leaves_nothing_beside_a_database(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    consumer("pycolmap")
    monkeypatch.setattr(import_module("decomo_runtime.formats.colmap"), "check_room", lambda *_: None)  # full since
    with writes_end_at(4096), pytest.raises(RuntimeError):
        journey().tracks.save(tmp_path / "a.db")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "tracks", [journey().tracks, journey(300, 3).tracks, journey(20, 60).tracks, wandering_tracks(30, 40)]
)
def test_room_for_all_of_it_is_looked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, tracks: Tracks):
    clip = tmp_path / "clip"
    clip.mkdir()
    noise = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)
    for number in range(int(tracks.frames[-1]) + 1):
        cv2.imwrite(str(clip / f"{number}.png"), noise[::-1] if number % 2 else noise)
    module = import_module(f"decomo_runtime.formats.{format_of(Path(name)).module}")
    sizes: list[int] = []
    monkeypatch.setattr(module, "check_room", lambda _, size: sizes.append(size))
    if name != "a.db" or len(tracks.xy) > 30:
        tracks.save(tmp_path / name, about=About(clip=clip))
        assert (tmp_path / name).stat().st_size < sizes[0] < 2**22 + 3 * (tmp_path / name).stat().st_size

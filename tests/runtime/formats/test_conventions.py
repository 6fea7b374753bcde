"""Where the first pixel, the last one and the middle of a frame of 640x360 are in each tool, and in which frame."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from decomo_runtime import About, Tracks
from known_tracks import HEIGHT, PLACES, WIDTH, known_tracks, wandering_tracks
from tool_readers import (
    Read,
    read_3dequalizer,
    read_after_effects,
    read_corner_pin,
    read_nuke,
    read_pftrack,
    read_syntheyes,
)

Place = tuple[float, float]
NUKE = "nuke", "a.nk", read_nuke
EQUALIZER = "3dequalizer", "a.txt", read_3dequalizer
SYNTHEYES = "syntheyes", "a.txt", lambda text: read_syntheyes(text)[0]
PFTRACK = "pftrack", "a.txt", read_pftrack
AFTER_EFFECTS = (
    "after-effects",
    "a.txt",
    lambda text: {path[1]: keys for path, keys in read_after_effects(text)[1].items()},
)
FROM_CORNER = {(0, 0): (0.5, 359.5), (639, 359): (639.5, 0.5), (319.5, 179.5): (320, 180), (10.25, 20.5): (10.75, 339)}
"""y up from the bottom left corner: the frame is 640 wide from edge to edge, a pixel's centre half a pixel inside."""


@pytest.fixture
def written(tmp_path: Path) -> Callable[..., str]:
    def write(to: str, name: str, tracks: Tracks | None = None, **about: object) -> str:
        (tracks or known_tracks()).save(tmp_path / name, to, about=About(**about))  # pyright: ignore[reportArgumentType]
        return (tmp_path / name).read_text()

    return write


class TestKnownTrack:
    """The point "corner" is in the first pixel in frame 0, in the last one in 1, hidden in 2, in the middle in 3."""

    def test_nuke(self, written: Callable[..., str]):
        corner = read_nuke(written("nuke", "a.nk"))["point_00"]
        assert corner == {1: (0.5, 359.5), 2: (639.5, 0.5), 4: (320.0, 180.0), 5: (10.75, 339.0)}

    def test_after_effects(self, written: Callable[..., str]):
        source, properties = read_after_effects(written("after-effects", "a.txt", pixel_aspect=1.5))
        assert source == {
            **{"Units Per Second": 25, "Source Width": 640, "Source Height": 360},
            **{"Source Pixel Aspect Ratio": 1.5, "Comp Pixel Aspect Ratio": 1.5},
        }
        corner = properties["Effects", "ADBE Point Control #1", "ADBE Point Control-0001"]
        assert corner == {0: (0.5, 0.5), 1: (639.5, 359.5), 3: (320.0, 180.0), 4: (10.75, 21.0)}

    def test_after_effects_layers(self, tmp_path: Path):
        known_tracks().save(tmp_path / "layers", "after-effects-layers")
        assert sorted(file.name for file in (tmp_path / "layers").iterdir()) == ["point_00.txt", "point_01.txt"]
        _, properties = read_after_effects((tmp_path / "layers" / "point_00.txt").read_text())
        assert properties == {
            ("Transform", "Position"): {0: (0.5, 0.5, 0), 1: (639.5, 359.5, 0), 3: (320, 180, 0), 4: (10.75, 21, 0)},
            ("Transform", "Opacity"): {0: (100,), 1: (100,), 2: (0,), 3: (100,), 4: (100,)},
        }

    def test_3dequalizer(self, written: Callable[..., str]):
        corner = read_3dequalizer(written("3dequalizer", "a.txt"))["point_00"]
        assert corner == {1: (0.5, 359.5), 2: (639.5, 0.5), 4: (320.0, 180.0), 5: (10.75, 339.0)}

    def test_syntheyes(self, written: Callable[..., str]):
        places, outcomes = read_syntheyes(written("syntheyes", "a.txt"))
        last = (round(2 * 10.25 / 639 - 1, 9), round(2 * 20.5 / 359 - 1, 9))
        assert places["point_00"] == {0: (-1, -1), 1: (1, 1), 3: (0, 0), 4: last}
        assert [outcomes["point_00", frame] for frame in (0, 1, 3, 4)] == [15, 7, 15, 7]

    def test_pftrack(self, written: Callable[..., str]):
        corner = read_pftrack(written("pftrack", "a.txt"))["point_00"]
        assert corner == {1: (0.0, 359.0), 2: (639.0, 0.0), 4: (319.5, 179.5), 5: (10.25, 338.5)}

    @pytest.mark.parametrize(("to", "name", "read"), [NUKE, EQUALIZER, SYNTHEYES, PFTRACK, AFTER_EFFECTS])
    def test_hidden_frames_have_no_key_and_hidden_points_are_left_out(
        self, written: Callable[..., str], to: str, name: str, read: Callable[[str], Read]
    ):
        found = read(written(to, name))
        first = min(map(min, found.values()))
        assert [{frame - first for frame in keys} for keys in found.values()] == [set(keys) for keys in PLACES.values()]

    @pytest.mark.parametrize(("to", "name", "read"), [NUKE, EQUALIZER, SYNTHEYES, PFTRACK, AFTER_EFFECTS])
    def test_first_frame(self, written: Callable[..., str], to: str, name: str, read: Callable[[str], Read]):
        found = read(written(to, name, first_frame=1001))
        assert [list(keys) for keys in found.values()] == [[1001, 1002, 1004, 1005], [1004, 1005]]


BACK: list[tuple[str, str, Callable[[str], Read], int, Callable[[float, float], Place]]] = [
    (*NUKE, 1, lambda x, y: (x - 0.5, HEIGHT - 0.5 - y)),
    (*EQUALIZER, 1, lambda x, y: (x - 0.5, HEIGHT - 0.5 - y)),
    (*SYNTHEYES, 0, lambda x, y: ((x + 1) / 2 * (WIDTH - 1), (y + 1) / 2 * (HEIGHT - 1))),
    (*PFTRACK, 1, lambda x, y: (x, HEIGHT - 1 - y)),
    (*AFTER_EFFECTS, 0, lambda x, y: (x - 0.5, y - 0.5)),
]


@pytest.mark.parametrize(("to", "name", "read", "first", "back"), BACK, ids=[row[0] for row in BACK])
def test_what_a_tool_reads_is_what_was_tracked(
    written: Callable[..., str],
    to: str,
    name: str,
    read: Callable[[str], Read],
    first: int,
    back: Callable[[float, float], Place],
):
    tracks = wandering_tracks()
    found = list(read(written(to, name, tracks)).values())
    assert len(found) == len(tracks.xy)
    for row, keys in enumerate(found):
        seen = ~tracks.occluded[row]
        assert [frame - first for frame in keys] == tracks.frames[seen].tolist()
        places = [back(*place) for place in keys.values()]
        np.testing.assert_allclose(places, tracks.xy[row, seen], atol=6e-5)  # four decimals


def test_a_clip_that_begins_at_0_in_nuke(written: Callable[..., str]):
    assert list(read_nuke(written("nuke", "a.nk", first_frame=0))["point_01"]) == [3, 4]


def test_corner_pin(written: Callable[..., str]):
    corners = np.array([[600, 40], [10, 20], [590, 300], [30, 350]], np.float32)  # as they were clicked
    xy = corners[:, None] + np.arange(3, dtype=np.float32)[:, None]
    occluded = np.zeros((4, 3), bool)
    occluded[0, 0] = occluded[1, 1] = True
    queries = np.concatenate([np.full((4, 1), 2, np.float32), xy[:, 2]], axis=1)
    tracks = Tracks(xy, occluded, occluded.astype(np.float32), queries, np.arange(3), (HEIGHT, WIDTH))
    pin = read_corner_pin(written("nuke-corner-pin", "a.nk", tracks))
    bottom_left, bottom_right, top_right, top_left = (pin[f"to{number}"] for number in (1, 2, 3, 4))
    assert bottom_left == ({1: 30.5, 2: 31.5, 3: 32.5}, {1: 9.5, 2: 8.5, 3: 7.5})
    assert bottom_right == ({1: 590.5, 2: 591.5, 3: 592.5}, {1: 59.5, 2: 58.5, 3: 57.5})
    assert top_right == ({2: 601.5, 3: 602.5}, {2: 318.5, 3: 317.5})
    assert top_left == ({1: 10.5, 3: 12.5}, {1: 339.5, 3: 337.5})
    assert [pin[f"from{number}"] for number in (1, 2, 3, 4)] == [(0, 0), (640, 0), (640, 360), (0, 360)]
    assert pin["label"] == r"to3 without key: 1\nto4 without key: 2"


def test_corner_pin_that_stands_on_its_tip(written: Callable[..., str]):
    """The first corner is the one nearest to the frame's bottom left, the others follow against the clock."""
    top, right, bottom, left = corners = np.array([[160, 20], [400, 200], [250, 340], [10, 179]], np.float32)
    seen = np.zeros((4, 1), bool)
    queries = np.concatenate([np.zeros((4, 1), np.float32), corners], axis=1)
    tracks = Tracks(corners[:, None], seen, seen.astype(np.float32), queries, np.arange(1), (HEIGHT, WIDTH))
    pin = read_corner_pin(written("nuke-corner-pin", "a.nk", tracks))
    places = [(pin[f"to{number}"][0][1] - 0.5, 359.5 - pin[f"to{number}"][1][1]) for number in (1, 2, 3, 4)]
    assert places == [tuple(left), tuple(bottom), tuple(right), tuple(top)]
    assert pin["label"] == ""


def test_the_label_of_a_corner_pin_counts_frames(written: Callable[..., str]):
    corners = np.array([[0, 90], [90, 90], [90, 0], [0, 0]], np.float32)
    hidden = np.zeros((4, 9), bool)
    hidden[1, [0, 2, 3, 4, 7, 8]] = True
    tracks = Tracks(
        *(np.repeat(corners[:, None], 9, axis=1), hidden, hidden.astype(np.float32)),
        *(np.concatenate([np.ones((4, 1), np.float32), corners], axis=1), np.arange(9), (HEIGHT, WIDTH)),
    )
    pin = read_corner_pin(written("nuke-corner-pin", "a.nk", tracks, first_frame=1001))
    assert pin["label"] == "to2 without key: 1001 1003-1005 1008-1009"

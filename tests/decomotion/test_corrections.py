"""Corrections before any fit: the file, its lines as points, what windows know of them, and what contradicts them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from decomotion.clip import Clip
from decomotion.corrections.file import HEADER, read_corrections
from decomotion.corrections.points import CorrectedPoint, Place
from decomotion.corrections.seams import in_windows
from decomotion.corrections.trusted import Bent, blending, contradiction, offsets_around, trusted_tracks
from decomotion.errors import CorrectionError
from decomotion.windows import Window, Windows
from tiny_fit import randomised, tiny_model

FRAMES, HEIGHT, WIDTH = 9, 20, 34
CLIP = Clip("blank", np.zeros((FRAMES, HEIGHT, WIDTH, 3), np.uint8))
HIDDEN = math.nan


def written(folder: Path, *lines: str, header: str = HEADER) -> Path:
    file = folder / "corrections.csv"
    file.write_text("\n".join([header, *lines]) + "\n", encoding="utf-8")
    return file


def test_lines_of_one_point_are_taken_together(tmp_path: Path):
    lines = ("0,3,4,5,10,11", "0,3,4,7,,", "2,30,15,1,29,15", "5,10,11,8,12.5,11", "0,3,4,5,10,11")
    first, second = read_corrections(written(tmp_path, *lines), CLIP)
    assert first.frames.tolist() == [0, 5, 8]
    assert first.xy.tolist() == [[3, 4], [10, 11], [12.5, 11]]
    assert first.hidden.tolist() == [7]
    assert (second.frames.tolist(), second.xy.tolist()) == ([1, 2], [[29, 15], [30, 15]])


def test_a_line_may_tell_that_two_points_are_one(tmp_path: Path):
    lines = ("0,3,4,5,10,11", "2,30,15,1,29,15", "5,10,11,2,30,15")
    (point,) = read_corrections(written(tmp_path, *lines), CLIP)
    assert point.frames.tolist() == [0, 1, 2, 5]


def test_the_file_may_be_as_a_spreadsheet_writes_it(tmp_path: Path):
    file = tmp_path / "corrections.csv"
    header = "target_y;target_x;NAME;t;x;y;target_t"
    file.write_text(f"{header}\n11,5;10;Hüfte;0;3;4;5\n;;Hüfte;0;3;4;7\n\n", encoding="utf-16")
    (point,) = read_corrections(file, CLIP)
    assert (point.frames.tolist(), point.hidden.tolist()) == ([0, 5], [7])
    assert point.xy.tolist() == [[3, 4], [10, 11.5]]


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("9,3,4,5,10,11", "line 2: t is 9 but the clip has the frames 0 to 8"),
        ("0,3,4,-1,10,11", "target_t is -1 but the clip has the frames 0 to 8"),
        ("0,33.6,4,5,10,11", "x is 33.6, outside of the frame, -0.5 to 33.5"),
        ("0,3,4,5,10,20", "target_y is 20, outside of the frame, -0.5 to 19.5; leave it empty where the point is not"),
        ("4,3,4,4,10,11", "t and target_t are both 4"),
        ("0,3,4,5,10,", "gives one of target_x and target_y"),
        ("0,,4,5,10,11", "must give numbers"),
        ("0,3,4,5,10,nan", "must give finite numbers"),
        ("0.5,3,4,5,10,11", "t is 0.5; it must be a whole frame number"),
        ("0,3,4,1e300,10,11", "but the clip has the frames 0 to 8"),
        ("0,3,4,5,10", "has 5 values but the header names 6 columns"),
    ],
)
def test_a_line_that_cannot_be_is_refused_by_name(tmp_path: Path, line: str, said: str):
    with pytest.raises(CorrectionError) as refusal:
        read_corrections(written(tmp_path, line), CLIP)
    assert said in str(refusal.value)


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (("0,3,4,5,10,11", "0,3,4,5,12,11"), "line 3 says that a point is at (12, 11) in frame 5, but"),
        (("0,3,4,5,10,11", "0,3,4,5,,"), "is hidden in frame 5"),
        (("0,3,4,5,10,11", "1,3,4,5,12,11", "0,3,4,1,3,4"), "in frame 5"),
        ((), "holds no correction"),
    ],
)
def test_lines_that_contradict_each_other_are_refused(tmp_path: Path, lines: tuple[str, ...], said: str):
    with pytest.raises(CorrectionError) as refusal:
        read_corrections(written(tmp_path, *lines), CLIP)
    assert said in str(refusal.value)


def test_what_is_no_such_file_is_refused(tmp_path: Path):
    with pytest.raises(CorrectionError, match="cannot be read"):
        read_corrections(tmp_path / "none.csv", CLIP)
    with pytest.raises(CorrectionError, match="no column target_t"):
        read_corrections(written(tmp_path, "0,1,1", header="t,x,y,target_x,target_y"), CLIP)
    (tmp_path / "binary.csv").write_bytes(b"t,x\0y")
    with pytest.raises(CorrectionError, match="not a text file"):
        read_corrections(tmp_path / "binary.csv", CLIP)


def test_a_track_changes_over_with_time_or_where_the_two_meet():
    frames, still = np.array([2, 6]), np.zeros((FRAMES, 2))
    first, second = blending(frames, np.stack([still, still + 30]))
    assert first == pytest.approx([1, 1, 1, 0.75, 0.5, 0.25, 0, 0, 0])
    assert second == pytest.approx(1 - first)
    passing = still + np.abs(np.arange(FRAMES) - 4)[:, None] * 40  # at the same place in frame 4
    first, second = blending(frames, np.stack([still, passing]))
    assert first[3] > 0.8
    assert first[5] < 0.2
    assert first + second == pytest.approx(np.ones(FRAMES))


# windows: 0 to 9 and 6 to 17, which share 6 to 9; then a cut at 18
LAYOUT = Windows(
    "three", 24, HEIGHT, WIDTH, 24.0, (Window("window-000", 0, 10), Window("window-001", 6, 18), Window("w", 18, 24))
)


def drifting(number: int, place: Place) -> np.ndarray:
    """Tracks of a model: a pixel a frame to the right in window 0, a pixel down in the next."""
    steps = np.arange(len(LAYOUT.windows[number])) - place.t
    return np.array(place[1:]) + steps[:, None] * (np.array([1, 0]) if number == 0 else np.array([0, 1]))


def test_a_correction_within_a_window_concerns_no_other():
    point = CorrectedPoint.of([Place(10, 3, 4), Place(15, 8, 9)])
    taught = in_windows([point], LAYOUT, drifting)
    assert list(taught) == [1]
    assert taught[1][0].frames.tolist() == [4, 9]


def test_a_correction_across_a_seam_is_handed_over_where_both_ways_meet():
    taught = in_windows([CorrectedPoint.of([Place(2, 3, 4), Place(14, 9, 16)])], LAYOUT, drifting)
    # at frame 8: (9, 4) from the one, (9, 10) from the other, half of the time away from each
    assert taught[0][0].places == [Place(2, 3, 4), Place(8, 9, 7)]
    assert taught[1][0].places == [Place(2, 9, 7), Place(8, 9, 16)]


def test_a_point_hidden_in_the_next_window_is_followed_there():
    taught = in_windows([CorrectedPoint.of([Place(2, 3, 4), Place(14, HIDDEN, HIDDEN)])], LAYOUT, drifting)
    assert list(taught) == [1]
    assert taught[1][0].frames.tolist() == [2]
    assert taught[1][0].xy.tolist() == [[9, 4]]
    assert taught[1][0].hidden.tolist() == [8]


def test_no_correction_leads_across_a_cut():
    with pytest.raises(CorrectionError, match="across the cut at frame 18"):
        in_windows([CorrectedPoint.of([Place(14, 3, 4), Place(20, 3, 4)])], LAYOUT, drifting)


@pytest.mark.parametrize("beyond", [2.0, 40.0])
def test_a_place_beyond_the_border_is_known_and_taught_nothing(beyond: float):
    """A seam may be crossed there. `beyond` in pixels: near enough that points around it are inside, or not."""
    model = randomised(tiny_model("cpu"), 0.05)
    outside = (model.plane.width - 0.5 + beyond, 10.0)
    tracks = trusted_tracks(model, [CorrectedPoint.of([Place(1, 10, 11), Place(3, *outside)])])
    at_both = (tracks.xy[:, 1] == (10, 11)).all(-1) & (tracks.xy[:, 3] == outside).all(-1)
    assert at_both.sum() == 2  # the point itself, by either place
    assert (tracks.trust[at_both][:, 1] == 1).all()
    assert (tracks.trust[at_both][:, 3] == 0).all()


def test_links_contradict_that_lead_elsewhere_or_to_where_the_point_is_hidden():
    unit = 0.5
    point = CorrectedPoint.of([Place(0, 5, 5), Place(3, 20, 5), Place(4, HIDDEN, HIDDEN)])
    track = np.array([[5, 5], [10, 5], [15, 5], [20, 5], [25, 5]], float)
    bent = Bent(point, track, np.array([1, 1, 1, 1, 0], bool), moving=True)

    def found(frame: int, xy: tuple[float, float], target: int, target_xy: tuple[float, float]) -> float:
        ends = np.array([frame]), np.array([xy], float), np.array([target]), np.array([target_xy], float)
        return float(contradiction([bent], *ends, unit)[0])

    assert found(0, (5, 5), 3, (20, 5)) == 0
    assert found(0, (5, 5), 3, (8, 5)) == 1
    assert found(3, (20, 5), 0, (12, 9)) == 1
    assert found(0, (12, 9), 3, (20, 5)) == 1  # something else leads to where the point is
    assert found(0, (25, 15), 3, (8, 5)) == pytest.approx(0, abs=1e-6)  # far away
    assert 0.5 < found(0, (6, 5), 3, (8, 5)) < 1  # near by
    assert found(0, (6, 5), 3, (21, 5)) == 0  # moves along
    assert found(0, (5, 5), 4, (25, 5)) == 1
    assert found(0, (5, 5), 4, (10, 5)) == 0


@pytest.mark.parametrize("x", ["-0.5", "33.5"])
def test_a_place_may_be_on_the_outermost_pixel_s_edge(tmp_path: Path, x: str):
    (point,) = read_corrections(written(tmp_path, f"0,{x},4,5,10,11"), CLIP)
    assert point.xy[0, 0] == float(x)


@pytest.mark.parametrize(("apart", "points"), [("0.009", 1), ("0.02", 2)])
def test_places_are_one_that_are_a_hundredth_of_a_pixel_apart(tmp_path: Path, apart: str, points: int):
    lines = ("0,3,4,5,10,11", f"5,10,{11 + float(apart)},8,12,12")
    assert len(read_corrections(written(tmp_path, *lines), CLIP)) == points


def test_a_column_that_is_there_twice_is_refused(tmp_path: Path):
    with pytest.raises(CorrectionError, match="no column x"):
        read_corrections(written(tmp_path, "0,1,1,2,3,4,5", header="t,x,x,y,target_t,target_x,target_y"), CLIP)


# windows: 0 to 9, 6 to 17 and 14 to 25
CHAIN = Windows(
    "chain", 26, HEIGHT, WIDTH, 24.0, (Window("window-000", 0, 10), Window("w1", 6, 18), Window("w2", 14, 26))
)


def wandering(number: int, place: Place) -> np.ndarray:
    """Tracks of a model: a pixel a frame to the right in window 0, down in the next, both in the last."""
    steps = np.arange(len(CHAIN.windows[number])) - place.t
    return np.array(place[1:]) + steps[:, None] * np.array([[1, 0], [0, 1], [1, 1]][number])


def test_a_correction_across_two_seams_goes_by_each_window_on_the_way():
    """At 8 it is (9, 4) from the one side and (12, 14) from the other, at 16 (9, 12) and (12, 22)."""
    taught = in_windows([CorrectedPoint.of([Place(2, 3, 4), Place(24, 20, 30)])], CHAIN, wandering)
    assert list(taught) == [0, 1, 2]
    first, second = (9 + 3 * 3 / 11, 4 + 10 * 3 / 11), (9 + 3 * 7 / 11, 12 + 10 * 7 / 11)
    for number, frames, xy in (
        (0, [2, 8], [(3, 4), first]),
        (1, [2, 10], [first, second]),
        (2, [2, 10], [second, (20, 30)]),
    ):
        assert taught[number][0].frames.tolist() == frames
        np.testing.assert_allclose(taught[number][0].xy, xy)


def test_a_point_hidden_in_the_window_before_is_followed_back():
    taught = in_windows([CorrectedPoint.of([Place(2, HIDDEN, HIDDEN), Place(13, 9, 16)])], CHAIN, wandering)
    assert list(taught) == [0]
    (part,) = taught[0]
    assert (part.frames.tolist(), part.xy.tolist(), part.hidden.tolist()) == ([8], [[9, 11]], [2])


def test_of_two_windows_the_nearer_tells_where_a_hidden_point_was():
    """Known in windows 0 and 1, hidden in 2: it is followed from window 1."""
    places = [Place(2, 3, 4), Place(12, 11, 8), Place(22, HIDDEN, HIDDEN)]
    taught = in_windows([CorrectedPoint.of(places)], CHAIN, wandering)
    assert taught[2][0].xy.tolist() == [[11, 12]]
    assert (taught[2][0].frames.tolist(), taught[2][0].hidden.tolist()) == ([2], [8])


def test_a_place_alone_teaches_nothing():
    assert in_windows([CorrectedPoint.of([Place(2, 3, 4)])], CHAIN, wandering) == {}
    both = [Place(12, 9, 8), Place(13, 9, 16)], [Place(1, 2, 3), Place(3, 4, 5)]
    assert list(in_windows([CorrectedPoint.of(each) for each in both], CHAIN, wandering)) == [0, 1]


def test_offsets_are_evenly_spread_over_two_deviations():
    """A sunflower's seeds: as many in equal areas, each a golden angle on, 137.5 degrees."""
    offsets = offsets_around(513, 1.5)
    radius = np.linalg.norm(offsets, axis=1)
    assert offsets[0].tolist() == [0, 0]
    np.testing.assert_allclose(radius[[128, 512]], [1.5, 3])
    angles = np.degrees(np.arctan2(offsets[1:, 1], offsets[1:, 0]))
    np.testing.assert_allclose(np.diff(angles) % 360, 137.508, atol=0.001)
    assert offsets_around(1, 1.5).tolist() == [[0, 0]]


@pytest.mark.parametrize(("beside", "allowed"), [(0.0, 1.0), (2.0, 2.0)])
def test_a_link_may_miss_by_two_units_and_half_of_its_distance(beside: float, allowed: float):
    """A unit is half a pixel; `beside` in pixels, from where a standing point is."""
    point = CorrectedPoint.of([Place(0, 5, 5), Place(1, 5, 5)])
    bent = Bent(point, np.full((2, 2), 5.0), np.ones(2, bool), moving=False)
    missed = np.array([allowed - 0.1, allowed + 0.1])
    xy = np.array([[5.0, 5.0 + beside]] * 2)
    found = contradiction([bent], np.zeros(2, int), xy, np.ones(2, int), xy + missed[:, None] * (0, 1), 0.5)
    np.testing.assert_allclose(found, [0, np.exp(-0.5 * (beside / 1.5) ** 2)])

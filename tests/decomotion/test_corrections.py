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
from decomotion.corrections.trusted import Bent, blending, contradiction, trusted_tracks
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

"""Windows cover a clip, overlap within a shot and nowhere else, and are read back as they were written."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from decomotion.errors import ClipError
from decomotion.windows import FILE_NAME, OVERLAP, SHORTEST, Window, Windows, split, whole_of


def layout(windows: tuple[Window, ...], **changes: object) -> Windows:
    facts = {"clip": "walk", "num_frames": windows[-1].end, "height": 40, "width": 28, "fps": 24.0, "windows": windows}
    return Windows(**{**facts, **changes})  # type: ignore[arg-type]


@pytest.mark.parametrize("frames", [101, 300, 1999, 3600])
@pytest.mark.parametrize("longest", [100, 48])
def test_windows_of_a_long_shot_share_a_dozen_frames(frames: int, longest: int):
    windows = split(frames, [], longest)
    assert [window.name for window in windows[:2]] == ["window-000", "window-001"]
    assert (windows[0].begin, windows[-1].end) == (0, frames)
    assert {one.end - two.begin for one, two in pairwise(windows)} == {OVERLAP}
    lengths = [len(window) for window in windows]
    assert max(lengths) - min(lengths) <= 1
    assert max(lengths) <= longest
    assert sum(lengths) - OVERLAP * (len(lengths) - 1) == frames


@pytest.mark.parametrize("longest", range(SHORTEST, 41))
def test_no_frame_lies_in_more_than_two(longest: int):
    for frames in range(longest, 4 * longest):
        windows = split(frames, [], longest)
        covering = [sum(window.begin <= frame < window.end for window in windows) for frame in range(frames)]
        assert set(covering) <= {1, 2}
        assert (2 in covering) == (frames > longest)


def test_a_shot_that_fits_is_one_window_and_none_leads_across_a_cut():
    assert split(100, [], 100) == (Window("window-000", 0, 100),)
    windows = split(260, [30, 40], 100)
    assert [(window.begin, window.end) for window in windows[:2]] == [(0, 30), (30, 40)]
    assert windows[2].begin == 40
    assert windows[2].end - windows[3].begin == OVERLAP


def test_a_frame_is_at_home_where_it_lies_farther_from_either_end():
    windows = layout(split(300, [130], 100))
    home = windows.home(np.arange(300))
    for frame in range(300):
        inside = [n for n, window in enumerate(windows.windows) if window.begin <= frame < window.end]
        margins = [min(frame - windows.windows[n].begin, windows.windows[n].end - 1 - frame) for n in inside]
        assert home[frame] in inside
        assert margins[inside.index(home[frame])] >= max(margins) - 1
    assert [list(windows.shared(n)) == [] for n in range(len(windows.windows) - 1)].count(True) == 1


def test_written_and_read(tmp_path: Path):
    for windows in (
        layout(split(40, [], 20)),
        layout(split(9, [4], 20), seconds=tuple(np.arange(9) ** 1.5), pixel_aspect=1.5),
    ):
        windows.save(tmp_path / FILE_NAME, digest="abc")
        assert Windows.load(tmp_path / FILE_NAME, ClipError) == windows
    assert windows.times[4] == 8
    assert layout(split(40, [], 20)).times[12] == 0.5


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format_version": 2}, "has format version 2 but this decomotion reads 1; upgrade it"),
        ({"num_frames": 41}, "do not cover the clip"),
        ({"fps": 0}, "contradicts itself"),
        ({"seconds": [0.0, 1.0]}, "contradicts itself"),
        ({"seconds": [0.0, *[1.0] * 39]}, "contradicts itself"),
        ({"windows": []}, "contradicts itself"),
        ({"windows": [{"name": "../up", "begin": 0, "end": 40}]}, "contradicts itself"),
        (
            {"windows": [{"name": "window-0", "begin": 0, "end": 40}, {"name": "window-0", "begin": 5, "end": 40}]},
            "cover",
        ),
        (
            {"windows": [{"name": "window-0", "begin": 0, "end": 20}, {"name": "window-1", "begin": 21, "end": 40}]},
            "cover",
        ),
        ({"windows": [{"name": "window-0", "begin": 0, "end": None}]}, "does not tell where"),
        ({"clip": None, "height": "tall"}, "does not tell where"),
        ({"quality": [None]}, "contradicts itself"),
        ({"quality": [None, {"steps": 3}, None]}, "does not tell where"),
        ({"quality": 3}, "does not tell where"),
    ],
)
def test_what_contradicts_itself_is_refused(changes: dict, message: str, tmp_path: Path):
    layout(split(40, [], 20)).save(tmp_path / FILE_NAME)
    content = json.loads((tmp_path / FILE_NAME).read_text())
    (tmp_path / FILE_NAME).write_text(json.dumps(content | changes))
    with pytest.raises(ClipError, match=message):
        Windows.load(tmp_path / FILE_NAME, ClipError)


def test_windows_by_hand():
    """Of a hundred frames about, which share twelve; of shorter ones a quarter."""
    bounds = {
        (300, 100): [(0, 84), (72, 156), (144, 228), (216, 300)],
        (40, 16): [(0, 16), (12, 28), (24, 40)],
        (30, 18): [(0, 17), (13, 30)],
    }
    for (frames, longest), expected in bounds.items():
        assert [(window.begin, window.end) for window in split(frames, [], longest)] == expected


def test_a_window_is_left_in_the_middle_of_what_it_shares():
    """Of frames 12 to 15 the first two belong to the one, the others to the next."""
    windows = layout(split(28, [], 16))
    assert [(window.begin, window.end) for window in windows.windows] == [(0, 16), (12, 28)]
    assert windows.home(np.arange(28)).tolist() == [0] * 14 + [1] * 14


def test_times_begin_at_0(tmp_path: Path):
    layout(split(9, [], 20), seconds=tuple(np.arange(9.0))).save(tmp_path / FILE_NAME)
    assert Windows.load(tmp_path / FILE_NAME, ClipError).times[8] == 8
    layout(split(9, [], 20), seconds=tuple(1 + np.arange(9.0))).save(tmp_path / FILE_NAME)
    with pytest.raises(ClipError, match="contradicts itself"):
        Windows.load(tmp_path / FILE_NAME, ClipError)


def test_a_window_s_folder_tells_what_it_is_a_part_of(tmp_path: Path):
    layout(split(300, [], 100)).save(tmp_path / FILE_NAME)
    assert whole_of(tmp_path / "window-002") == (tmp_path, 4)
    for other in (tmp_path / "window-004", tmp_path / "window-000" / "deeper", tmp_path):
        assert whole_of(other) == (other, 1)

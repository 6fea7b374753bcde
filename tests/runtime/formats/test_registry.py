"""The table of formats, what is asked of the caller, and what is refused."""

from __future__ import annotations

import inspect
import logging
import re
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from decomo_runtime import About, Tracks, TracksFileError
from decomo_runtime.formats import registry
from decomo_runtime.formats.keys import plain_names
from decomo_runtime.formats.registry import FORMATS, TracksFormat, format_of, rate_of, read
from known_tracks import known_tracks

DOCS = Path(__file__).parents[3] / "docs" / "convert.md"
KEYED = [
    format_of(Path(name), to)
    for name, to in (
        *(("a.nk", "nuke"), ("a.nk", "nuke-corner-pin"), ("a.txt", "after-effects"), ("a", "after-effects-layers")),
        *(("a.py", "blender"), ("a.txt", "3dequalizer"), ("a.txt", "syntheyes"), ("a.txt", "pftrack")),
    )
]
"""Formats of tools with keyframes, or gaps."""


@pytest.mark.parametrize("each", FORMATS, ids=lambda each: each.name)
def test_a_line_says_what_its_module_does(each: TracksFormat):
    module = import_module(f"decomo_runtime.formats.{each.module}")
    assert callable(module.write)
    assert hasattr(module, "read") == each.reads
    assert re.fullmatch(r"[a-z0-9-]+", each.name)
    assert all(re.fullmatch(r"\.[a-z0-9]+", ending) for ending in each.endings)
    limits = inspect.signature(module.check).parameters if hasattr(module, "check") else "nfa"
    assert len(limits) == 3
    assert each.folder == (not each.endings)


def test_names_are_different():
    assert len({each.name for each in FORMATS}) == len(FORMATS)


def test_the_documentation_has_a_row_for_each():
    rows = re.findall(r"^\| `([a-z0-9-]+)` \|", DOCS.read_text(), re.MULTILINE)
    assert sorted(rows) == sorted(each.name for each in FORMATS)


@pytest.mark.parametrize(
    ("name", "to", "found"),
    [
        *(("a.npz", None, "npz"), ("A.CSV", None, "csv"), ("a.json", None, "json"), ("a.nk", None, "nuke")),
        *(("a.nk", "nuke-corner-pin", "nuke-corner-pin"), ("a.py", None, "blender"), ("a.txt", "pftrack", "pftrack")),
        ("folder", "after-effects-layers", "after-effects-layers"),
    ],
)
def test_which_format(name: str, to: str | None, found: str):
    assert format_of(Path(name), to).name == found


@pytest.mark.parametrize(
    ("name", "to", "words"),
    [
        ("a.txt", None, r"several things by its ending; say which with --to \(to= in Python\): after-effects, 3deq"),
        ("a.xyz", None, r"a\.xyz does not end as a file of tracks does; give an ending of .*\.nk, .*, or say --to"),
        ("a", None, "a does not end as a file of tracks does"),
        ("a.nk", "nuk", "nuk is no format of tracks; there are npz, csv, json, nuke"),
        ("a.txt", "nuke", r"a\.txt: nuke is written as \.nk; give a name with that ending"),
        ("a.txt", "after-effects-layers", r"after-effects-layers is written as folder; give a name without an ending"),
    ],
)
def test_no_format(name: str, to: str | None, words: str, tmp_path: Path):
    with pytest.raises(TracksFileError, match=words):
        known_tracks().save(tmp_path / name, to)
    assert not list(tmp_path.iterdir())


def test_what_is_read(tmp_path: Path):
    with pytest.raises(TracksFileError, match=r"a\.nk is not a file of tracks by its ending; give \.npz or \.csv"):
        read(tmp_path / "a.nk")


def test_a_library_of_an_extra_that_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "needy.py").write_text("def write(tracks, path, about):\n    import no_such_library.part\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(registry, "import_module", lambda name: import_module(name.rpartition(".")[2]))
    needy = TracksFormat("needy", "needy", (".x",), "a test", extra="colmap")
    with pytest.raises(
        TracksFileError,
        match=r"^needy needs no_such_library, which is not installed; run: pip install 'decomotion\[colmap\]'$",
    ):
        needy.write(known_tracks(), tmp_path / "a.x", About())
    (tmp_path / "choosy.py").write_text("def check(number, frames, about):\n    import no_such_library.part\n")
    with pytest.raises(TracksFileError, match=r"^needy needs no_such_library, which is not installed"):
        replace(needy, module="choosy").check(3, np.arange(5), About())  # before anything is asked for
    with pytest.raises(ModuleNotFoundError):
        replace(needy, extra=None).write(known_tracks(), tmp_path / "a.x", About())
    assert not (tmp_path / "a.x").exists()


class TestWhatIsKnown:
    def test_size_and_rate_come_from_the_tracks(self, tmp_path: Path):
        known_tracks().save(tmp_path / "a.txt", "after-effects")
        known_tracks(sized=False, timed=False).save(
            tmp_path / "b.txt", "after-effects", about=About(size=(360, 640), fps=25)
        )
        assert (tmp_path / "a.txt").read_text() == (tmp_path / "b.txt").read_text()

    @pytest.mark.parametrize("rate", [30, 24, 240, 30000 / 1001, 23.976, 12.5, 0.5, 1 / 3])
    @pytest.mark.parametrize("length", [2, 6, 91, 1000])
    def test_the_rate_is_plain_though_a_csv_rounds_times(self, rate: float, length: int):
        for frames in (np.arange(length), 7 + np.arange(0, 2 * length, 2)):
            xy, occluded = np.zeros((1, length, 2), np.float32), np.zeros((1, length), bool)
            queries = np.array([[frames[0], 0, 0]], np.float32)
            tracks = Tracks(
                xy, occluded, occluded.astype(np.float32), queries, frames, times=np.round(frames / rate, 6)
            )
            found = rate_of(tracks)
            assert found == pytest.approx(rate, rel=2.1e-6 * rate)  # a microsecond of each time
            if rate in (30, 24, 240, 12.5, 0.5):
                assert found == rate
            elif rate == 30000 / 1001:
                assert found == pytest.approx(rate, rel=1e-12)  # of any length: it is plainer than 29.970030
            elif length > 900:
                assert found == pytest.approx(rate, abs=1e-6)

    @pytest.mark.parametrize("times", [[0, 1, np.nan], [np.nan, 1, 2], [0, 1, np.inf], [0, 0, 0], [2, 1, 0]])
    def test_times_that_tell_no_rate(self, times: list[float]):
        xy, occluded = np.zeros((1, 3, 2), np.float32), np.zeros((1, 3), bool)
        queries = np.zeros((1, 3), np.float32)
        tracks = Tracks(xy, occluded, occluded.astype(np.float32), queries, np.arange(3), times=np.array(times, float))
        assert rate_of(tracks) is None

    @pytest.mark.parametrize(
        ("about", "what"),
        [(About(points=("nose",)), "name"), (About(colours=("#ffffff", "#000000")), "colour")],
        ids=["names", "colours"],
    )
    def test_a_name_and_a_colour_for_each_point(self, about: About, what: str, tmp_path: Path):
        sentence = (
            f"one {what} for each of the 3 points, or none at all, but there are {len(about.points + about.colours)}"
        )
        with pytest.raises(TracksFileError, match=sentence):
            known_tracks().save(tmp_path / "a.json", about=about)
        assert not list(tmp_path.iterdir())

    def test_the_rate_of_every_second_frame(self, tmp_path: Path):
        tracks = known_tracks()
        assert tracks.times is not None
        half = replace(
            tracks,
            **{name: getattr(tracks, name)[:, ::2] for name in ("xy", "occluded", "occlusion")},
            frames=tracks.frames[::2],
            times=tracks.times[::2],
        )
        half.save(tmp_path / "a.txt", "after-effects")
        assert "\tUnits Per Second\t25\n" in (tmp_path / "a.txt").read_text()

    @pytest.mark.parametrize("each", KEYED, ids=lambda each: each.name)
    def test_size_is_asked_for(self, each: TracksFormat, tmp_path: Path):
        tracks = known_tracks(sized=False)
        if each.name == "nuke-corner-pin":
            tracks = four(tracks)
        path = tmp_path / ("a" + "".join(each.endings))
        with pytest.raises(TracksFileError, match="do not say the clip's size; give --size WIDTHxHEIGHT"):
            tracks.save(path, each.name)
        assert not list(tmp_path.iterdir())

    def test_rate_is_asked_for(self, tmp_path: Path):
        with pytest.raises(TracksFileError, match="do not say the clip's frame rate; give --fps"):
            known_tracks(timed=False).save(tmp_path / "a.txt", "after-effects")
        one = replace(
            known_tracks(),
            **{name: getattr(known_tracks(), name)[:, :1] for name in ("xy", "occluded", "occlusion")},
            frames=np.array([0]),
            times=np.array([0.0]),
        )
        with pytest.raises(TracksFileError, match="do not say the clip's frame rate"):
            one.save(tmp_path / "a.txt", "after-effects")

    def test_frames_that_tell_no_rate(self, tmp_path: Path):
        same = replace(known_tracks(), frames=np.array([2, 1, 0, 1, 2]), times=np.array([0.08, 0.04, 0, 0.04, 0.08]))
        with pytest.raises(TracksFileError, match="do not say the clip's frame rate"):
            same.save(tmp_path / "a.txt", "after-effects")

    @pytest.mark.parametrize(
        ("about", "words"),
        [
            (About(size=(480, 640)), "in frames of 640x360 but those of the clip are 640x480"),
            (About(length=4), "reach frame 4 but the clip has 4 frames, from 0"),
        ],
    )
    def test_another_clip(self, about: About, words: str, tmp_path: Path):
        with pytest.raises(TracksFileError, match=words):
            known_tracks().save(tmp_path / "a.nk", about=about)

    @pytest.mark.parametrize(
        ("place", "taken"),
        [
            *(((-0.5, -0.5), True), ((639.5, 359.5), True), ((639.6, 9), False), ((-0.6, 9), False)),
            *(((9, 359.6), False), ((9, -0.6), False)),
        ],
    )
    def test_points_are_given_up_to_the_edge_of_the_frame(
        self, place: tuple[float, float], taken: bool, tmp_path: Path
    ):
        tracks = known_tracks(sized=False)
        tracks.queries[1, 1:] = place
        about = About(size=(360, 640))
        if taken:
            tracks.save(tmp_path / "a.nk", about=about)
            return
        with pytest.raises(TracksFileError, match=r"point 1 .*, outside of frames of 640x360; give the clip"):
            tracks.save(tmp_path / "a.nk", about=about)

    def test_another_clip_of_a_csv(self, tmp_path: Path):
        with pytest.raises(TracksFileError, match=r"point 2 .* at \(5, 5\), outside of frames of 640x5; give the clip"):
            known_tracks(sized=False).save(tmp_path / "a.nk", about=About(size=(5, 640)))


def four(tracks):
    """The middle point's neighbours, four corners that never move."""
    xy = np.tile(np.array([[10, 10], [90, 12], [88, 70], [9, 75]], np.float32)[:, None], (1, 5, 1))
    queries = np.concatenate([np.zeros((4, 1), np.float32), xy[:, 0]], axis=1)
    seen = np.zeros((4, 5), bool)
    return replace(tracks, xy=xy, occluded=seen, occlusion=seen.astype(np.float32), queries=queries)


class TestKeys:
    @pytest.mark.parametrize("each", KEYED, ids=lambda each: each.name)
    def test_points_that_are_never_in_sight(self, each: TracksFormat, tmp_path: Path, caplog: pytest.LogCaptureFixture):
        if each.name == "nuke-corner-pin":
            return
        path = tmp_path / ("a" + "".join(each.endings))
        with caplog.at_level(logging.INFO, "decomo_runtime"):
            known_tracks().save(path, each.name)
        assert caplog.messages == ["1 of 3 points are in sight in none of the frames and are left out"]

    def test_nothing_in_sight(self, tmp_path: Path):
        tracks = known_tracks()
        with pytest.raises(TracksFileError, match="no point is in sight in any of the frames"):
            replace(tracks, occluded=np.ones_like(tracks.occluded)).save(tmp_path / "a.nk")

    def test_a_place_that_is_none(self, tmp_path: Path):
        tracks = known_tracks()
        tracks.xy[1, 3, 0] = np.nan
        with pytest.raises(TracksFileError, match=r"point 1 .* is in sight at no finite place"):
            tracks.save(tmp_path / "a.nk")

    def test_frames_in_another_order(self, tmp_path: Path):
        tracks, order = known_tracks(), [3, 1, 4, 0, 2, 3]
        mixed = replace(
            tracks,
            **{name: getattr(tracks, name)[:, order] for name in ("xy", "occluded", "occlusion")},
            frames=tracks.frames[order],
            times=None,
        )
        tracks.save(tmp_path / "a.nk")
        mixed.save(tmp_path / "b.nk")
        assert (tmp_path / "a.nk").read_text() == (tmp_path / "b.nk").read_text()

    def test_names(self):
        given = ["Point 1", "Point 1", "Point_1_2", " ", "", "ö", 'a"b\\[c]{d}$', "..", "a.b-C_9", "POINT 1"]
        assert plain_names(given) == [
            *("Point_1", "Point_1_2", "Point_1_2_2", "point", "point_2", "point_3", "a_b_c_d", "point_4", "a.b-C_9"),
            "POINT_1_3",
        ]

    def test_numbered_names_sort_as_they_count(self):
        names = About().names(1200)
        assert names[:2] == ["point_0000", "point_0001"]
        assert sorted(names) == names


class TestCornerPin:
    def test_other_numbers_of_points(self, tmp_path: Path):
        with pytest.raises(TracksFileError, match="is made of 4 points, the corners, but there are 3"):
            known_tracks().save(tmp_path / "a.nk", "nuke-corner-pin")

    def test_no_quadrangle(self, tmp_path: Path):
        tracks = four(known_tracks())
        tracks.xy[2] = (40, 30)
        with pytest.raises(TracksFileError, match="in frame 1 of Nuke one of the points lies within the triangle"):
            tracks.save(tmp_path / "a.nk", "nuke-corner-pin")

    def test_three_corners_on_a_line(self, tmp_path: Path):
        tracks = four(known_tracks())
        tracks.xy[1] = (50, 10)
        tracks.xy[2] = (90, 10)
        with pytest.raises(TracksFileError, match="lies within the triangle of the others, or on its border"):
            tracks.save(tmp_path / "a.nk", "nuke-corner-pin")

    def test_a_corner_that_is_never_in_sight(self, tmp_path: Path):
        tracks = four(known_tracks())
        tracks.occluded[2] = True
        with pytest.raises(TracksFileError, match="needs a frame in which all 4 points are in sight; these have none"):
            tracks.save(tmp_path / "a.nk", "nuke-corner-pin")
        assert not list(tmp_path.iterdir())

    def test_never_together(self, tmp_path: Path):
        tracks = four(known_tracks())
        tracks.occluded[0, :3] = tracks.occluded[1, 3:] = True
        with pytest.raises(TracksFileError, match="needs a frame in which all 4 points are in sight"):
            tracks.save(tmp_path / "a.nk", "nuke-corner-pin")


def test_a_full_folder_is_not_written_into(tmp_path: Path):
    (tmp_path / "layers").mkdir()
    (tmp_path / "layers" / "mine.txt").write_text("kept")
    with pytest.raises(OSError, match="not empty"):
        known_tracks().save(tmp_path / "layers", "after-effects-layers")
    assert [file.name for file in (tmp_path / "layers").iterdir()] == ["mine.txt"]

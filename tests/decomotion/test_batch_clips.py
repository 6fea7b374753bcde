"""Which clips a folder or a list means, and what is wrong with those that mean none."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

from decomotion.batch.clips import Entry, read_clips, together
from decomotion.errors import BatchError


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two videos, two folders of frames, and what is no clip."""
    clips = tmp_path / "clips"
    for name in (
        "walk.MP4",
        "b.run.mov",
        "notes.txt",
        ".hidden.mp4",
        "frames/001.jpg",
        "omni/color/1.png",
        "empty/a.txt",
    ):
        (clips / name).parent.mkdir(parents=True, exist_ok=True)
        (clips / name).touch()
    return clips


def test_a_folder_holds_videos_and_folders_of_frames(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        entries = read_clips(folder)
    assert [entry.name for entry in entries] == ["b.run", "frames", "omni", "walk"]
    assert [entry.source for entry in entries][::3] == [str(folder / "b.run.mov"), str(folder / "walk.MP4")]
    assert f"in {folder}, left out for being no clips: empty, notes.txt" in caplog.text


def test_a_list_names_them_from_its_own_folder_on(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "list.txt").write_text(
        f"\ufeff# those of today\n\n clips/walk.MP4 \nclips/walk.MP4@3:9\r\n{folder}/frames\n"
    )
    monkeypatch.chdir(folder)
    assert read_clips("../list.txt") == [
        Entry("walk", str(folder / "../clips/walk.MP4")),
        Entry("walk-3-9", str(folder / "../clips/walk.MP4@3:9")),
        Entry("frames", str(folder / "frames")),
    ]


def test_a_table_gives_names_queries_and_options(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "points.csv").write_text("t,x,y\n0,3,4\n")
    (tmp_path / "masks").mkdir()
    table = tmp_path / "list.csv"
    table.write_text(
        "clip, name, queries, options\n"
        "clips/walk.MP4,first,points.csv,--seed 7 --masks masks --set optim.points=32\n"
        'clips/frames,,,"--masks none"\n'
    )
    own = ("--set", "optim.points=32", "--masks", str(tmp_path / "masks"), "--seed", "7")
    assert read_clips(table) == [
        Entry("first", str(folder / "walk.MP4"), tmp_path / "points.csv", own),
        Entry("frames", str(folder / "frames"), None, ("--masks", "none")),
    ]


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.txt", "", "holds no clips; put paths of clips there"),
        ("a.txt", "x/walk.mp4\ny/Walk.mov\n", "walk.mp4 and .*Walk.mov would both be called Walk; rename one"),
        ("a.txt", "x.mp4@5:6\n", "@5:6 is not two or more frames"),
        ("a.csv", "path,name\nx.mp4,x\n", "has the columns path, name; it needs clip"),
        ("a.csv", "clip,clip\nx.mp4,x\n", "has the columns clip, clip"),
        ("a.csv", "clip,name\nx.mp4\n", "row 1 of .* has not as many cells as the header"),
        ("a.csv", "clip,name\nx.mp4,x,--seed 1\n", "row 1 of .* has not as many cells"),
        ("a.csv", "clip,name\n,x\n", "row 1 of .* names no clip"),
        ("a.csv", "clip,queries\nx.mp4,absent.csv\n", "absent.csv, which is no file"),
        ("a.csv", 'clip,name\n"x"y,x\n', "is no table of comma-separated values"),
        ("a.csv", "clip,options\nx.mp4,--sed 7\n", "row 1 of .*, options: No such option:? '?--sed"),
        ("a.csv", "clip,options\nx.mp4,--help\n", "asks for help"),
        ("a.csv", "clip,options\nx.mp4,--out there\n", "--out is of all clips; give it to decomo-batch"),
        ("a.csv", "clip,options\nx.mp4,--set optim.point=1\n", "there is no key optim.point"),
        ("a.csv", "clip,options\nx.mp4,--steps 3 --time-budget 5m\n", "give --time-budget or --steps, not both"),
        ("a.csv", "clip,options\nx.mp4,--set 'optim\n", "No closing quotation"),
    ],
)
def test_other_lists_are_refused(tmp_path: Path, name: str, text: str, words: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(ValueError, match=words):
        read_clips(tmp_path / name)


@pytest.mark.parametrize("encoding", ["utf-16", "latin-1"])
def test_a_list_as_spreadsheets_write_it(tmp_path: Path, encoding: str) -> None:
    """The first line is a comment, cells are separated by semicolons."""
    (tmp_path / "a.csv").write_text("# Clips\n\nClip;Name\nhöhe.mp4;x, y\n\n# b.mp4;y\n", encoding=encoding)
    assert read_clips(tmp_path / "a.csv") == [Entry("x, y", str(tmp_path / "höhe.mp4"))]


def test_other_folders_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BatchError, match="does not exist; give a folder of clips, or a list"):
        read_clips(tmp_path / "absent")
    with pytest.raises(BatchError, match="holds no clips; put videos or folders of frames there"):
        read_clips(tmp_path)
    (tmp_path / "walk.mp4").touch()
    (tmp_path / "Walk").mkdir()
    (tmp_path / "Walk" / "1.png").touch()
    with pytest.raises(BatchError, match="would both be called walk; rename one"):
        read_clips(tmp_path)
    (tmp_path / "2.png").touch()
    with pytest.raises(BatchError, match="holds frames, so it is one clip"):
        read_clips(tmp_path)


def test_what_is_no_text_is_no_list(tmp_path: Path) -> None:
    (tmp_path / "walk.mp4").write_bytes(b"\x00\xff\xfe")
    with pytest.raises(BatchError, match="it is no text in UTF-8"):
        read_clips(tmp_path / "walk.mp4")


def test_a_clip_s_own_budget_stands_in_for_that_of_all() -> None:
    common = ("--time-budget", "600.0", "--seed", "3")
    assert together(common, ()) == common
    assert together(common, ("--seed", "4")) == (*common, "--seed", "4")
    assert together(common, ("--steps", "9")) == ("--seed", "3", "--steps", "9")

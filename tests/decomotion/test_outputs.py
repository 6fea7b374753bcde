from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from decomotion.errors import OutputError
from decomotion.outputs import check_folder, check_new_folder, check_not_input, check_output

SUFFIXES = (".npz", ".csv")


@pytest.mark.parametrize("name", ["a.npz", "a.CSV", "new/folder/a.csv"])
def test_good(tmp_path: Path, name: str):
    check_output("--out", tmp_path / name, SUFFIXES)
    assert not list(tmp_path.iterdir())


def test_relative(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    check_output("--out", Path("a.csv"), SUFFIXES)


@pytest.mark.parametrize("name", ["a", "a.txt", "npz"])
def test_suffix(tmp_path: Path, name: str):
    with pytest.raises(OutputError, match=rf"--out .*{name} must end in \.npz or \.csv"):
        check_output("--out", tmp_path / name, SUFFIXES)


def test_folder(tmp_path: Path):
    (tmp_path / "a.npz").mkdir()
    with pytest.raises(OutputError, match=r"a\.npz is a folder"):
        check_output("--out", tmp_path / "a.npz", SUFFIXES)


def test_file_in_the_way(tmp_path: Path):
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="file is not a folder that you may write to"):
        check_output("--out", tmp_path / "file" / "a.npz", SUFFIXES)


def test_any_suffix(tmp_path: Path):
    check_output("--json", tmp_path / "scores")


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="there is no /proc")
@pytest.mark.parametrize("check", [check_output, check_folder, check_new_folder])
def test_where_even_root_may_not_write(check: Callable[[str, Path], None]):
    with pytest.raises(
        OutputError, match=r"--out /proc/new/a cannot be written \(.*\): /proc is not a folder that you"
    ):
        check("--out", Path("/proc/new/a"))


@pytest.mark.parametrize("check", [check_output, check_folder, check_new_folder])
def test_a_name_that_is_too_long(tmp_path: Path, check: Callable[[str, Path], None]):
    with pytest.raises(OutputError, match=r"cannot be written \(File name too long\); give another name"):
        check("--out", tmp_path / ("a" * 250))
    with pytest.raises(OutputError, match=r"cannot be written \(File name too long\)"):
        check("--out", tmp_path / ("a" * 300) / "a")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_no_permission(tmp_path: Path):
    tmp_path.chmod(0o500)
    with pytest.raises(OutputError, match="is not a folder that you may write to"):
        check_output("--out", tmp_path / "a.npz", SUFFIXES)


@pytest.mark.parametrize("given", ["goat.mp4", "goat.mp4@0:48", "same/../goat.mp4", "link.mp4@1:2"])
def test_an_input_is_not_replaced(tmp_path: Path, given: str):
    (tmp_path / "goat.mp4").touch()
    (tmp_path / "same").mkdir()
    (tmp_path / "link.mp4").symlink_to(tmp_path / "goat.mp4")
    with pytest.raises(OutputError, match=rf"--out .*goat\.mp4 would replace .*{given}, which is read"):
        check_not_input("--out", tmp_path / "goat.mp4", None, tmp_path / "none.csv", tmp_path / given)
    check_not_input("--out", tmp_path / "new.mp4", None, tmp_path / given)


def test_a_new_folder(tmp_path: Path):
    check_new_folder("--out", tmp_path / "new" / "folder")
    (tmp_path / "empty").mkdir()
    check_new_folder("--out", tmp_path / "empty")
    with pytest.raises(OutputError, match=r"--out .* exists already; give the name of a new folder"):
        check_new_folder("--out", tmp_path)
    (tmp_path / "file").touch()
    for path in (tmp_path / "file", tmp_path / "file" / "a"):
        with pytest.raises(OutputError, match=r"exists already|is not a folder that you may write to"):
            check_new_folder("--out", path)


def test_a_folder_may_hold_something(tmp_path: Path):
    (tmp_path / "file").touch()
    check_folder("--out", tmp_path)
    check_folder("--out", tmp_path / "new" / "folder")
    check_folder("--out", Path("."))  # noqa: PTH201
    for path in (tmp_path / "file", tmp_path / "file" / "a"):
        with pytest.raises(OutputError, match="file is not a folder that you may write to"):
            check_folder("--out", path)
    assert [file.name for file in tmp_path.iterdir()] == ["file"]

from __future__ import annotations

import os
from pathlib import Path

import pytest

from decomo_runtime import TracksFileError
from decomo_runtime.outputs import check_new_folder, check_not_input, check_output

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
    with pytest.raises(TracksFileError, match=rf"--out .*{name} must end in \.npz or \.csv"):
        check_output("--out", tmp_path / name, SUFFIXES)


def test_folder(tmp_path: Path):
    (tmp_path / "a.npz").mkdir()
    with pytest.raises(TracksFileError, match=r"a\.npz is a folder"):
        check_output("--out", tmp_path / "a.npz", SUFFIXES)


def test_file_in_the_way(tmp_path: Path):
    (tmp_path / "file").touch()
    with pytest.raises(TracksFileError, match="file is not a folder that you may write to"):
        check_output("--out", tmp_path / "file" / "a.npz", SUFFIXES)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_no_permission(tmp_path: Path):
    tmp_path.chmod(0o500)
    with pytest.raises(TracksFileError, match="is not a folder that you may write to"):
        check_output("--out", tmp_path / "a.npz", SUFFIXES)


@pytest.mark.parametrize("given", ["goat.mp4", "goat.mp4@0:48", "same/../goat.mp4", "link.mp4@1:2"])
def test_an_input_is_not_replaced(tmp_path: Path, given: str):
    (tmp_path / "goat.mp4").touch()
    (tmp_path / "same").mkdir()
    (tmp_path / "link.mp4").symlink_to(tmp_path / "goat.mp4")
    with pytest.raises(TracksFileError, match=rf"--out .*goat\.mp4 would replace .*{given}, which is read"):
        check_not_input("--out", tmp_path / "goat.mp4", None, tmp_path / "none.csv", tmp_path / given)
    check_not_input("--out", tmp_path / "new.mp4", None, tmp_path / given)


def test_a_new_folder(tmp_path: Path):
    check_new_folder("--out", tmp_path / "new" / "folder")
    (tmp_path / "empty").mkdir()
    check_new_folder("--out", tmp_path / "empty")
    with pytest.raises(TracksFileError, match=r"--out .* exists already; give the name of a new folder"):
        check_new_folder("--out", tmp_path)
    (tmp_path / "file").touch()
    for path in (tmp_path / "file", tmp_path / "file" / "a"):
        with pytest.raises(TracksFileError, match=r"exists already|is not a folder that you may write to"):
            check_new_folder("--out", path)

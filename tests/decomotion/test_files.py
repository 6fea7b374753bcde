"""`replacing`: a file is either the old one or the whole new one; `new_folder`: a folder is whole or not there."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from decomotion.files import new_folder, replacing


def names_in(folder: Path) -> list[str]:
    return [entry.name for entry in folder.iterdir()]


def test_writes_a_new_file_and_its_folders(tmp_path: Path):
    target = tmp_path / "runs" / "goat" / "model.bin"
    with replacing(target) as temporary:
        assert temporary.parent == target.parent
        assert temporary.suffix == ".bin"  # writers choose the format by it
        temporary.write_bytes(b"new")
        assert not target.exists()
    assert target.read_bytes() == b"new"
    assert names_in(target.parent) == ["model.bin"]


def test_replaces_the_old_file(tmp_path: Path):
    target = tmp_path / "model.bin"
    target.write_bytes(b"the old and longer content")
    with replacing(str(target)) as temporary:
        temporary.write_bytes(b"new")
    assert target.read_bytes() == b"new"


@pytest.mark.parametrize("failure", [ValueError, KeyboardInterrupt])
def test_an_exception_leaves_the_old_file(failure: type[BaseException], tmp_path: Path):
    target = tmp_path / "model.bin"
    target.write_bytes(b"old")
    with pytest.raises(failure), replacing(target) as temporary:  # noqa: PT012
        temporary.write_bytes(b"half")
        raise failure
    assert target.read_bytes() == b"old"
    assert names_in(tmp_path) == ["model.bin"]


def test_an_exception_before_anything_was_written_leaves_nothing(tmp_path: Path):
    with pytest.raises(ValueError, match="before"), replacing(tmp_path / "model.bin"):
        raise ValueError("before")
    assert names_in(tmp_path) == []


def test_kill_leaves_the_old_file(tmp_path: Path):
    target = tmp_path / "model.bin"
    target.write_bytes(b"old")
    killed_while_writing = (
        "import os, signal, sys\n"
        "from decomotion.files import replacing\n"
        "with replacing(sys.argv[1]) as temporary:\n"
        "    temporary.write_bytes(b'half')\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    process = subprocess.run([sys.executable, "-c", killed_while_writing, str(target)], timeout=60)
    assert process.returncode == -signal.SIGKILL
    assert target.read_bytes() == b"old"


@pytest.mark.parametrize("empty_one_is_there", [False, True])
def test_a_new_folder_appears_whole(tmp_path: Path, empty_one_is_there: bool):
    target = tmp_path / "runs" / "frames"
    if empty_one_is_there:
        target.mkdir(parents=True)
    with new_folder(target) as temporary:
        (temporary / "a").write_bytes(b"new")
        assert not target.exists() or not names_in(target)
    assert names_in(target) == ["a"]
    assert names_in(target.parent) == ["frames"]


def test_the_folder_that_one_is_in_appears_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "frames").mkdir()
    monkeypatch.chdir(tmp_path / "frames")
    with new_folder(".") as temporary:
        (temporary / "a").write_bytes(b"new")
    assert names_in(tmp_path) == ["frames"]
    assert names_in(tmp_path / "frames") == ["a"]


def test_an_exception_leaves_no_folder(tmp_path: Path):
    with pytest.raises(KeyboardInterrupt), new_folder(tmp_path / "frames") as temporary:  # noqa: PT012
        (temporary / "a").write_bytes(b"half")
        raise KeyboardInterrupt
    assert names_in(tmp_path) == []


def test_a_folder_with_something_in_it_is_not_replaced(tmp_path: Path):
    (tmp_path / "frames").mkdir()
    (tmp_path / "frames" / "old").touch()
    with pytest.raises(OSError, match="not empty"), new_folder(tmp_path / "frames") as temporary:
        (temporary / "a").touch()
    assert names_in(tmp_path) == ["frames"]
    assert names_in(tmp_path / "frames") == ["old"]

"""`replacing`: a file is either the old one or the whole new one; `new_folder`: a folder is whole or not there."""

from __future__ import annotations

import errno
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from decomotion.files import check_room, naming, new_folder, replacing
from full_disk import writes_end_at


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


VALUES = np.random.default_rng(0).integers(0, 256, 50_000, np.uint8)


def saved_by_torch(path: Path) -> None:
    with path.open("wb") as file:
        torch.save({"values": torch.from_numpy(VALUES)}, file)


def saved_by_numpy(save: Callable[..., None]) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        with path.open("wb") as file:
            save(file, VALUES)

    return write


def copied(path: Path) -> None:
    source = path.with_name("source")
    shutil.copyfile(source, path)


@pytest.mark.parametrize(
    "write",
    [
        lambda path: path.write_bytes(VALUES.tobytes()),
        saved_by_torch,
        *(saved_by_numpy(save) for save in (np.save, np.savez, np.savez_compressed)),
        copied,
    ],
)
def test_a_full_disk_is_an_error_that_names_the_file(tmp_path: Path, write: Callable[[Path], None]):
    target = tmp_path / "out" / "model.bin"
    target.parent.mkdir()
    target.write_bytes(b"old")
    (target.parent / "source").write_bytes(VALUES.tobytes())
    with writes_end_at(20_000), pytest.raises(OSError) as failure, replacing(target) as temporary:  # noqa: PT011
        write(temporary)
    assert failure.value.filename == str(target)
    assert failure.value.strerror is not None
    assert target.read_bytes() == b"old"
    assert sorted(names_in(target.parent)) == ["model.bin", "source"]


def test_a_full_disk_is_an_error_that_names_the_folder(tmp_path: Path):
    with writes_end_at(20_000), pytest.raises(OSError) as failure, new_folder(tmp_path / "frames") as temporary:  # noqa: PT011, PT012
        (temporary / "a").write_bytes(b"whole")
        (temporary / "b").write_bytes(VALUES.tobytes())
    assert failure.value.filename == str(tmp_path / "frames")
    assert names_in(tmp_path) == []


def raised_in(block: Path, error: Exception) -> Exception:
    with pytest.raises(type(error)) as caught, naming(block):
        raise error
    return caught.value


@pytest.mark.parametrize(
    "error",
    [
        OSError("no file to name"),
        OSError(errno.ENOSPC, "No space left on device", "/elsewhere/a"),
        PermissionError(errno.EACCES, "Permission denied"),
        RuntimeError("of another kind"),
        ValueError("not of a file"),
    ],
)
def test_other_errors_are_left_alone(tmp_path: Path, error: Exception):
    assert raised_in(tmp_path, error) is error


def test_room_is_looked_for_and_nothing_is_left(tmp_path: Path):
    check_room(tmp_path / "a", 2**20)
    with writes_end_at(2**16), pytest.raises(OSError, match="File too large"):
        check_room(tmp_path / "a", 2**20)
    assert not list(tmp_path.iterdir())

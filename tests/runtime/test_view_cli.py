"""`decomo-view` up to the browser: what it writes and what it refuses."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from children import child
from decomo_runtime.view import cli
from decomo_runtime.view.site import PAGE
from decomotion.clip import read_clip
from decomotion.windows import FILE_NAME, Windows, split
from full_disk import writes_end_at
from tiny_model import write_tiny_model


def test_export_writes_page_model_and_clip(model_path: Path, clip_path: Path, tmp_path: Path):
    site = tmp_path / "new" / "site"
    assert cli.main([str(model_path), "--clip", str(clip_path), "--export", str(site)]) == 0
    assert (site / "model.onnx").read_bytes() == model_path.read_bytes()
    assert (site / "index.html").read_bytes() == (PAGE / "index.html").read_bytes()
    record = json.loads((site / "site.json").read_text())
    clip = read_clip(clip_path)
    assert record["model"] == "model.onnx"
    assert record["refit"] is False
    assert record["clip"]["name"] == clip.name
    pictures = [cv2.imread(str(site / name)) for name in record["clip"]["frames"]]
    assert len(pictures) == len(clip)
    for picture, frame in zip(pictures, clip.frames, strict=True):
        assert picture is not None
        assert (
            np.abs(picture[..., ::-1].astype(int) - frame).mean() < 8
        )  # of noise, at which JPEG is worst; another frame: 85
    assert sorted(path.name for path in site.parent.iterdir()) == ["site"]


def test_export_without_a_clip_into_an_empty_folder(model_path: Path, tmp_path: Path):
    (tmp_path / "site").mkdir()
    assert cli.main([str(model_path), "--export", str(tmp_path / "site")]) == 0
    assert json.loads((tmp_path / "site" / "site.json").read_text())["clip"] is None


@pytest.fixture
def model_folder(tmp_path: Path) -> Path:
    folder = tmp_path / "walk"
    layout = Windows("walk", 30, 40, 48, 12.5, split(30, [], 14))
    for window in layout.windows:
        write_tiny_model(folder / f"{window.name}.onnx", num_frames=len(window), height=40, width=48)
    layout.save(folder / FILE_NAME)
    return folder


def test_a_model_folder_is_copied_and_nothing_else_in_it(model_folder: Path, tmp_path: Path):
    (model_folder / "notes.txt").write_text("mine")
    site = tmp_path / "site"
    assert cli.main([str(model_folder), "--export", str(site)]) == 0
    assert json.loads((site / "site.json").read_text())["model"] == "model/windows.json"
    copied = {file.name: file.read_bytes() for file in (site / "model").iterdir()}
    names = ["window-000.onnx", "window-001.onnx", "window-002.onnx", "windows.json"]
    assert copied == {name: (model_folder / name).read_bytes() for name in names}


def test_refuses_a_model_folder_that_is_not_whole(
    model_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    (model_folder / "window-001.onnx").unlink()
    assert "lacks window-001.onnx" in refusal(capsys, model_folder, "--export", tmp_path / "site")
    (model_folder / FILE_NAME).unlink()
    assert f"a folder without {FILE_NAME}" in refusal(capsys, model_folder, "--export", tmp_path / "site")
    assert not (tmp_path / "site").exists()


def refusal(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """The one sentence with which `decomo-view` refuses `arguments`."""
    assert cli.main([str(argument) for argument in arguments]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("Error: ")
    assert printed.err.count("\n") == 1
    return printed.err


@pytest.mark.parametrize("size", [1000, 2_000_000])
def test_a_full_disk_leaves_nothing(model_path: Path, tmp_path: Path, size: int, capsys: pytest.CaptureFixture[str]):
    with writes_end_at(size):  # a file of the page itself, or one in a folder of it
        said = refusal(capsys, model_path, "--export", tmp_path / "new" / "site")
    assert said == f"Error: {tmp_path / 'new' / 'site'}: File too large\n"
    assert list((tmp_path / "new").iterdir()) == []


def test_refuses_what_is_no_model(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "text.onnx").write_text("hello")
    foreign = write_tiny_model(
        tmp_path / "f.onnx", num_frames=3, height=8, width=8, metadata={"decomotion.format_version": None}
    )
    assert "does not exist" in refusal(capsys, tmp_path / "none.onnx", "--export", tmp_path / "site")
    assert "not an ONNX file" in refusal(capsys, tmp_path / "text.onnx", "--export", tmp_path / "site")
    assert "holds no decomotion model" in refusal(capsys, foreign, "--export", tmp_path / "site")
    assert not (tmp_path / "site").exists()


def test_refuses_another_clip(model_path: Path, clip_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    shutil.copytree(clip_path, tmp_path / "short")
    next((tmp_path / "short").rglob("*.png")).unlink()
    arguments = ["--clip", tmp_path / "short", "--export", tmp_path / "out" / "site"]
    assert "give that clip" in refusal(capsys, model_path, *arguments)
    assert not (tmp_path / "out").exists()


def test_refuses_a_folder_that_is_not_empty(model_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    folder = tmp_path / "work"
    folder.mkdir()
    (folder / "thesis.txt").write_text("years of work")
    assert "exists already; give the name of a new folder" in refusal(capsys, model_path, "--export", folder)
    assert [path.name for path in folder.iterdir()] == ["thesis.txt"]


@pytest.mark.parametrize("option", [["--port", "8080"], ["--no-browser"]])
def test_refuses_to_serve_and_export(
    option: list[str], model_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    arguments = [model_path, "--export", tmp_path / "site", *option]
    assert "--export serves nothing; leave out --port and --no-browser" in refusal(capsys, *arguments)
    assert not (tmp_path / "site").exists()


@pytest.mark.parametrize("ending", [signal.SIGTERM, signal.SIGHUP])
def test_the_folder_served_is_private_and_goes_when_the_command_is_ended(
    ending: signal.Signals, model_path: Path, tmp_path: Path
):
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    command = [sys.executable, "-c", "from decomo_runtime.view.cli import main; raise SystemExit(main())"]
    environment = os.environ | {"TMPDIR": str(temporary)}
    with child([*command, model_path, "--no-browser"], environment) as process:
        assert process.stdout is not None
        assert "(Ctrl-C ends)" in process.stdout.readline()
        modes = [folder.stat().st_mode & 0o777 for folder in temporary.glob("decomo-view-*")]
        process.send_signal(ending)
    assert modes == [0o700]
    assert list(temporary.glob("decomo-view-*")) == []


def test_refuses_a_port_in_use(model_path: Path, capsys: pytest.CaptureFixture[str]):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert f"port {port} is in use" in refusal(capsys, model_path, "--no-browser", "--port", port)

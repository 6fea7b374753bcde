"""Commands with a model on a full disk: one sentence, exit code 2, and nothing half-written."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from decomo_runtime import Tracker
from decomo_runtime.cli import main as track
from decomo_runtime.convert_cli import main as convert
from decomo_runtime.propagation.cli import main as propagate
from full_disk import writes_end_at

HEIGHT, WIDTH = 40, 48


@pytest.fixture
def labels(tmp_path: Path) -> Path:
    image = np.zeros((HEIGHT, WIDTH), np.uint8)
    image[5:30, 8:40] = np.random.default_rng(0).integers(1, 4, (25, 32))
    cv2.imwrite(str(tmp_path / "labels.png"), image)
    return tmp_path / "labels.png"


@pytest.mark.parametrize("size", [0, 100])
def test_propagate(model_path: Path, labels: Path, tmp_path: Path, size: int, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "new" / "all"
    with writes_end_at(size):
        assert propagate([str(model_path), "--from", f"{labels}@2", "--out", str(out)]) == 2
    said = capsys.readouterr().err.split("\r")[-1]
    assert said == f"Error: {out}: File too large\n"  # the bar is gone
    assert list(out.parent.iterdir()) == []


@pytest.mark.parametrize("ending", ["npz", "csv", "json", "nk", "h5"])
@pytest.mark.parametrize("size", [0, 500])
def test_convert(model_path: Path, tmp_path: Path, ending: str, size: int, capsys: pytest.CaptureFixture[str]):
    Tracker(model_path).track(np.tile([0, 3, 4], (30, 1))).save(tmp_path / "a.npz")
    out = tmp_path / "new" / f"b.{ending}"
    to = {"nk": "nuke", "h5": "deeplabcut"}.get(ending, ending)
    with writes_end_at(size):
        assert convert([str(tmp_path / "a.npz"), str(out), "--to", to, "--fps", "24", "--size", "48x40"]) == 2
    said = capsys.readouterr().err
    assert said == f"Error: {out}: File too large\n"
    assert list(out.parent.iterdir()) == []


@pytest.mark.parametrize("size", [0, 100])
def test_track(model_path: Path, tmp_path: Path, size: int, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "new" / "a.npz"
    with writes_end_at(size):
        assert track([str(model_path), "--grid", "4@0", "--out", str(out)]) == 2
    assert capsys.readouterr().err == f"Error: {out}: File too large\n"
    assert list(out.parent.iterdir()) == []


def test_an_overlay(model_path: Path, clip_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """Tracks that were written before stay."""
    out, overlay = tmp_path / "a.npz", tmp_path / "new" / "a.mp4"
    asked = [str(model_path), "--grid", "4@0", "--out", str(out), "--clip", str(clip_path), "--overlay", str(overlay)]
    with writes_end_at(6000):
        assert track(asked) == 2
    assert capsys.readouterr().err.split("\r")[-1] == f"Error: {overlay}: File too large\n"
    assert list(overlay.parent.iterdir()) == []
    assert out.exists()

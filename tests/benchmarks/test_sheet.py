from __future__ import annotations

import pickle
from pathlib import Path

import cv2
import numpy as np
import pytest

import sheet
from decomotion.console import run
from tiny_model import write_tiny_model


def test_a_sheet_for_each_model(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Two rows of seven columns under a heading; the first column is the clip."""
    write_tiny_model(tmp_path / "runs" / "m.onnx", num_frames=4, height=10, width=20, clip_name="slide")
    grey = np.full((4, 10, 20, 3), 90, np.uint8)
    entry = {"video": grey, "points": np.full((1, 4, 2), 0.5), "occluded": np.zeros((1, 4), bool)}
    (tmp_path / "clips.pkl").write_bytes(pickle.dumps({"slide": entry}))
    monkeypatch.setattr(sheet, "remove_objects", lambda tracker, video, wanted: (video[frame] for frame in wanted))
    argv = [str(tmp_path / "clips.pkl"), str(tmp_path / "runs"), "--out", str(tmp_path / "out")]
    assert run(sheet.main, [*argv, "--frames", "0,3", "--width", "700"]) == 0
    picture = cv2.imread(str(tmp_path / "out" / "slide.jpg"))
    assert picture is not None
    assert picture.shape == (sheet.HEADING + 100, 700, 3)
    assert abs(int(picture[sheet.HEADING + 25, 50, 0]) - 90) <= 2
    assert abs(int(picture[sheet.HEADING + 75, 650, 0]) - 90) <= 2

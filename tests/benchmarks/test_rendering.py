from __future__ import annotations

import json
import math
import pickle
from pathlib import Path

import numpy as np
import pytest

from decomo_runtime import Tracker, render
from decomotion.console import run
from harness.pictures import intersection_over_union, psnr
from rendering import main
from tiny_model import write_tiny_model

FRAMES, HEIGHT, WIDTH = 4, 10, 16


def test_psnr_by_hand():
    black = np.zeros((2, 2, 3), np.uint8)
    assert psnr(black, black) == math.inf
    assert psnr(black, black + 255) == pytest.approx(0)
    assert psnr(black, black + np.uint8(51)) == pytest.approx(20 * math.log10(5))  # no 8-bit overflow
    assert psnr(black + 255, black + 204) == pytest.approx(20 * math.log10(5))


def test_intersection_over_union_by_hand():
    """Two of four pixels against three; nothing against nothing; nothing against something."""
    mask = np.array([[[1, 1, 0, 0]], [[0, 0, 0, 0]], [[0, 0, 0, 0]]], bool)
    truth = np.array([[[0, 1, 1, 1]], [[0, 0, 0, 0]], [[1, 0, 0, 0]]], bool)
    assert intersection_over_union(mask, truth) == pytest.approx((1 / 4 + 1 + 0) / 3)


@pytest.fixture
def command(tmp_path: Path) -> list[str]:
    """A clip off by one from what the tiny model renders, and masks that are right in half of its frames."""
    model = write_tiny_model(tmp_path / "m.onnx", num_frames=FRAMES, height=HEIGHT, width=WIDTH, clip_name="slide")
    tracker = Tracker(model)
    pictures = [render(tracker, frame, ["fused", "mask"]) for frame in range(FRAMES)]
    masks = np.stack([mask[..., 0] > 127 for _, mask in pictures])
    masks[::2] = ~masks[::2]
    entry = {
        "video": np.stack([fused for fused, _ in pictures]),
        "points": np.full((1, FRAMES, 2), 0.5),
        "occluded": np.zeros((1, FRAMES), bool),
    }
    entry["video"] ^= 1
    (tmp_path / "clips.pkl").write_bytes(pickle.dumps({"slide": entry}))
    np.savez(tmp_path / "masks.npz", slide=masks)
    return [*(str(tmp_path / name) for name in ("clips.pkl", "masks.npz", "m.onnx")), "--out", str(tmp_path / "out")]


def test_a_record_for_each_model(command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert run(main, [*command, "--every", "3"]) == 0
    record = json.loads((tmp_path / "out" / "slide.json").read_text())
    assert (record["clip"], record["frames"], record["every"], record["preset"]) == ("slide", 2, 3, "cpu")
    assert record["rendering"]["psnr"] == pytest.approx(20 * math.log10(255))
    assert record["rendering"]["mask_iou"] == 0.5  # frames 0 and 3
    assert "| slide | " in capsys.readouterr().out


def test_a_folder_of_runs(command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """Two models of different clips below it; the mean is over them, rendered now or before."""
    folder = tmp_path / "runs" / "slide-seed0"
    folder.mkdir(parents=True)
    (tmp_path / "m.onnx").rename(folder / "slide.onnx")
    command[2] = str(tmp_path / "runs")
    assert run(main, command) == 0
    assert "mean" not in capsys.readouterr().out
    entries = pickle.loads((tmp_path / "clips.pkl").read_bytes())
    (tmp_path / "clips.pkl").write_bytes(pickle.dumps({**entries, "slow": entries["slide"]}))
    masks = np.load(tmp_path / "masks.npz")["slide"]
    np.savez(tmp_path / "masks.npz", slide=masks, slow=masks)
    write_tiny_model(tmp_path / "runs" / "slow.onnx", num_frames=FRAMES, height=HEIGHT, width=WIDTH, clip_name="slow")
    assert run(main, command) == 0
    assert [line.split(" | ")[0] for line in capsys.readouterr().out.splitlines()[2:]] == [
        "| slide",
        "| slow",
        "| mean",
    ]
    (tmp_path / "none").mkdir()
    command[2] = str(tmp_path / "none")
    assert run(main, command) == 2
    assert "none holds no .onnx file" in capsys.readouterr().err


def test_what_has_a_record_is_not_rendered_again(
    command: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    assert run(main, [*command, "--every", "2"]) == 0
    monkeypatch.setattr(Tracker, "sample", None)
    assert run(main, [*command, "--every", "2"]) == 0
    capsys.readouterr()
    assert run(main, command) == 2
    assert "was made with another every" in capsys.readouterr().err

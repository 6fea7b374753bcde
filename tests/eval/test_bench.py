"""A whole benchmark with stand-ins for decomo-train and decomo-export: what is done, redone, retried and reported."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from decomo_eval.bench import task
from decomo_eval.bench.cli import main

TRAIN = """
import os, pathlib, signal, sys
frames, _, run = sys.argv[1:4]
assert sys.argv[4:6] == ["--shots", "ignore"] and "--preset" in sys.argv, sys.argv
clip = pathlib.Path(frames).name
assert len(list(pathlib.Path(frames).iterdir())) == 11
calls = pathlib.Path("calls") / clip
calls.mkdir(parents=True, exist_ok=True)
(calls / str(len(list(calls.iterdir())))).touch()
plan = pathlib.Path("plan") / clip
if plan.exists():
    if plan.read_text() == "killed once":
        plan.unlink()
        os.kill(os.getpid(), signal.SIGKILL)
    print("some progress\\nError: nothing moves in it")
    sys.exit(2)
pathlib.Path(run).mkdir()
"""
EXPORT = """
import pathlib, sys
model, _, run = sys.argv[1:4]
assert pathlib.Path(run).is_dir()
sys.path.insert(0, "{tests}")
from tiny_model import write_tiny_model
write_tiny_model(pathlib.Path(model), num_frames=11, width=32, height=20, clip_name="clip")
"""

Bench = Callable[..., int]


@pytest.fixture
def bench(dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Bench:
    """Runs decomo-bench in `tmp_path`, where `calls/<video>` counts fits and `plan/<video>` makes them fail."""
    pytest.importorskip("onnx", reason="onnx writes the models")
    monkeypatch.chdir(tmp_path)
    Path("plan").mkdir()
    tests = Path(__file__).parents[1]
    monkeypatch.setattr(task, "TRAIN", (sys.executable, "-c", TRAIN))
    monkeypatch.setattr(task, "EXPORT", (sys.executable, "-c", EXPORT.format(tests=tests)))
    return lambda *options: main([str(dataset), "--out", "out", *options])


def calls(video: str) -> int:
    folder = Path("calls") / video
    return len(list(folder.iterdir())) if folder.is_dir() else 0


def test_every_video_is_fitted_once_and_scored(bench: Bench, capsys: pytest.CaptureFixture[str]) -> None:
    assert bench("--jobs", "2") == 0
    assert "strided, mean over 2 videos: AJ " in capsys.readouterr().out
    summary = json.loads(Path("out/summary.json").read_text())
    assert sorted(outcome["name"] for outcome in summary["finished"]) == ["left", "right"]
    assert summary["mean"]["average_jaccard"] >= 0
    assert summary["hours_for"]["1000"] == pytest.approx(summary["seconds_per_video"] * 1000 / 2 / 3600, abs=0.01)
    assert Path("out/report/index.html").is_file()
    assert sorted(file.name for file in Path("out/videos/left").iterdir()) == ["log.txt", "run", "task.json"]
    assert bench() == 0
    assert (calls("left"), calls("right")) == (1, 1)
    assert {o["attempts"] for o in json.loads(Path("out/summary.json").read_text())["finished"]} == {0}


def test_a_killed_fit_is_tried_again(bench: Bench) -> None:
    Path("plan/left").write_text("killed once")
    assert bench() == 0
    assert (calls("left"), calls("right")) == (2, 1)
    assert json.loads(Path("out/videos/left/task.json").read_text())["attempts"] == 2


def test_a_failing_video_is_given_up_and_the_others_go_on(bench: Bench, capsys: pytest.CaptureFixture[str]) -> None:
    Path("plan/left").write_text("fails")
    assert bench("--attempts", "3") == 1
    assert (calls("left"), calls("right")) == (3, 1)
    assert "left: train ended with exit code 2: Error: nothing moves in it" in capsys.readouterr().err
    summary = json.loads(Path("out/summary.json").read_text())
    assert [outcome["name"] for outcome in summary["failed"]] == ["left"]
    assert json.loads(Path("out/report/scores.json").read_text())["missing"] == ["left"]
    Path("plan/left").unlink()
    assert bench() == 0  # the same command: only what failed
    assert (calls("left"), calls("right")) == (4, 1)


def test_all_may_fail(bench: Bench) -> None:
    Path("plan/left").write_text("fails")
    assert bench("--videos", "left") == 1
    assert json.loads(Path("out/summary.json").read_text())["mean"] is None


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--preset", "paper"], "out was made with another options; give another --out"),
        (["--videos", "up"], "has no video up"),
        (["--engine", "ray"], "'ray' is not"),
    ],
)
def test_bad_input_is_one_sentence(
    bench: Bench, capsys: pytest.CaptureFixture[str], options: list[str], words: str
) -> None:
    assert bench("--videos", "right") == 0
    assert bench(*options) == 2
    assert words in capsys.readouterr().err
    assert calls("right") == 1


@pytest.mark.parametrize("name", ["../up", ".hidden", "a/b", ""])
def test_names_that_are_no_files_are_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(task.DatasetError, match="cannot be a file's"):
        task.Task(name, tmp_path, (), 1)

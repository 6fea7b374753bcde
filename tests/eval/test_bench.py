"""A whole benchmark with stand-ins for decomo-train and decomo-export: what is done, redone, retried and reported.

Also on a real Ray of this machine, started by the command or reached by its address.
"""

from __future__ import annotations

import importlib.util
import json
import os
import pickle
import shutil
import socket
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import dataset_files
from decomo_eval.bench import run
from decomo_eval.bench.cli import main
from decomo_eval.dataset import Video, read_dataset, write_frames
from decomo_eval.errors import EvalError, PredictionError
from decomotion.clip import read_clip
from decomotion.errors import EngineError, InputError
from decomotion.jobs import clip_task, cluster
from decomotion.jobs import task as job
from decomotion.jobs.clip_task import COMMANDS, ClipTask
from decomotion.jobs.cluster import ENVIRONMENT, RayEngine
from decomotion.jobs.engine import LocalEngine, Room
from decomotion.jobs.lock import alone
from decomotion.jobs.task import Outcome, Place

TRAIN = """
import json, os, pathlib, signal, struct, sys, time
os.chdir("{root}")
pathlib.Path("arguments.json").write_text(json.dumps(sys.argv[1:]))
frames, _, run = sys.argv[1:4]
clip = pathlib.Path(frames).name
files = sorted(pathlib.Path(frames).iterdir())
width, height = struct.unpack(">II", files[0].read_bytes()[16:24])  # of a PNG
facts = dict(num_frames=len(files), width=width, height=height)
pathlib.Path("facts", clip).write_text(json.dumps(facts))
calls = pathlib.Path("calls") / clip
calls.mkdir(parents=True, exist_ok=True)
(calls / str(len(list(calls.iterdir())))).write_text(
    os.environ["OMP_NUM_THREADS"] + " " + os.environ.get("CUDA_VISIBLE_DEVICES", "all")
)
plan = pathlib.Path("plan") / clip
order = plan.read_text() if plan.exists() else "works"
if order == "killed once":
    plan.unlink()
    os.kill(os.getpid(), signal.SIGKILL)
if order == "kills its worker once":
    plan.unlink()
    pathlib.Path("orphan").write_text(str(os.getpid()))
    os.kill(os.getppid(), signal.SIGKILL)
    time.sleep(600)
if order.startswith("waits for "):
    for _ in range(3000):
        if pathlib.Path("calls", order.removeprefix("waits for "), "1").exists():
            break
        time.sleep(0.1)
if order == "killed in the middle" and "--resume" not in sys.argv:
    from decomotion.config import load
    from decomotion.record import Record
    from decomotion.schedule import Budget
    Record("digest", load("cpu"), 0, Budget(1)).write(pathlib.Path(run))
    pathlib.Path(run, "progress").write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
if order == "killed in the middle":
    assert pathlib.Path(run, "progress").read_text() == "half"
if order == "does not go on" and "--resume" in sys.argv:
    print("Error: the checkpoint is damaged")
    sys.exit(2)
if order == "is long":
    pathlib.Path(run).mkdir()
    pathlib.Path(run, "windows.json").touch()
    sys.exit()
if order == "fails":
    print("some progress\\nError: nothing moves in it")
    sys.exit(2)
pathlib.Path(run).mkdir(exist_ok=True)
"""
EXPORT = """
import json, pathlib, sys
model, _, run = sys.argv[1:4]
pathlib.Path("{root}", "export.json").write_text(json.dumps(sys.argv[1:]))
assert pathlib.Path(run).is_dir()
order = pathlib.Path("{root}", "plan", pathlib.Path(model).stem)
if order.exists() and order.read_text() == "is broken":
    pathlib.Path(model).write_bytes(b"no model")
    sys.exit()
if order.exists() and order.read_text() == "export fails":
    sys.exit(2)
sys.path.insert(0, "{tests}")
from tiny_model import write_tiny_model
file = pathlib.Path(model)
facts = json.loads(pathlib.Path("{root}", "facts", file.stem).read_text())
if pathlib.Path(run, "windows.json").is_file():
    from decomotion.windows import Window, Windows
    file.mkdir()
    frames, width, height = facts.values()
    layout = Windows("clip", frames, height, width, 12.5, (Window("window-000", 0, frames),))
    layout.save(file / "windows.json")
    file = file / "window-000.onnx"
write_tiny_model(file, **facts, clip_name="clip")
"""

Bench = Callable[..., int]
TOO_BUSY = "Ray did not start within the half minute that it gives itself: the machine is too busy"


@pytest.fixture
def bench(dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Bench:
    """Runs decomo-bench in `tmp_path`, where `calls/<video>` counts fits and `plan/<video>` makes them fail.

    On two videos, `left` and `right`, unless it is told on what.
    """
    pytest.importorskip("onnx", reason="onnx writes the models")
    monkeypatch.chdir(tmp_path)
    Path("plan").mkdir()
    Path("facts").mkdir()
    tests = Path(__file__).parents[1]
    train = TRAIN.replace("{root}", str(tmp_path))
    export = EXPORT.replace("{tests}", str(tests)).replace("{root}", str(tmp_path))
    monkeypatch.setattr(clip_task, "COMMANDS", {"train": ("-c", train), "export": ("-c", export)})
    return lambda *options, of=dataset: main([str(of), "--out", "out", *options])


TOO_BUSY = "Ray did not start within the half minute that it gives itself: the machine is too busy"


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
    assert sorted(file.name for file in Path("out/videos/left").iterdir()) == [
        "log.txt",
        "made.json",
        "run",
        "task.json",
    ]
    assert bench() == 0
    assert (calls("left"), calls("right")) == (1, 1)
    again = json.loads(Path("out/summary.json").read_text())
    assert {outcome["attempts"] for outcome in again["finished"]} == {0}
    assert again["hours_for"] == summary["hours_for"]  # of two at a time, as they were fitted


def test_the_commands_understand_what_they_are_given(bench: Bench) -> None:
    """Here stand-ins run; the arguments are parsed by the commands themselves."""
    pytest.importorskip("torch", reason="what fits needs torch")
    from decomo_export.cli import command as export
    from decomotion.cli import command as train

    assert all(flag == "-m" and importlib.util.find_spec(module) for flag, module in COMMANDS.values())
    settings = ["--set", "optim.points=32", "--set", "data.masks=none"]
    assert bench("--preset", "omnimotion", "--time-budget", "90s", "--seed", "7", *settings, "--videos", "left") == 0
    given = train.make_context("decomo-train", json.loads(Path("arguments.json").read_text())).params
    asked = {"preset": "omnimotion", "time_budget": 90.0, "steps": None, "seed": 7, "shots": "ignore"}
    assert {name: given[name] for name in asked} == asked
    assert list(given["overrides"]) == settings[1::2]
    assert given["prepared"] == "auto"
    export.make_context("decomo-export", json.loads(Path("export.json").read_text()))
    assert bench("--videos", "right", *settings, "--seed", "8", "--out", "other", "--prepared", "drop") == 0
    given = train.make_context("decomo-train", json.loads(Path("arguments.json").read_text())).params
    assert (given["seed"], given["prepared"]) == (8, "drop")


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


def test_a_video_asked_for_that_fails_is_missing_in_the_report(bench: Bench) -> None:
    Path("plan/left").write_text("fails")
    assert bench("--attempts", "1", "--videos", "left,right") == 1
    assert json.loads(Path("out/report/scores.json").read_text())["missing"] == ["left"]


def test_a_model_of_other_frames_is_not_scored(
    bench: Bench, dataset: Path, dataset_content: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    """A dataset was made anew under its old name: `left` is another video now."""
    assert bench() == 0
    dataset_content["left"]["video"][3] += 1
    dataset.write_bytes(pickle.dumps(dataset_content))
    assert bench() == 1
    assert "left.onnx was fitted to other frames than the clip has now; move it away" in capsys.readouterr().err
    scores = json.loads(Path("out/report/scores.json").read_text())
    assert (list(scores["videos"]), scores["missing"]) == (["right"], ["left"])
    assert (calls("left"), calls("right")) == (1, 1)
    Path("out/models/left.onnx").unlink()
    assert bench() == 0
    assert (calls("left"), calls("right")) == (2, 1)


def test_a_disk_s_error_costs_one_video(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(video: Video, folder: Path) -> Path:
        if video.name == "left":
            raise OSError("no space left on device")
        return write_frames(video, folder)

    monkeypatch.setattr(run, "write_frames", full)
    assert bench() == 1
    (failed,) = json.loads(Path("out/summary.json").read_text())["failed"]
    assert failed["error"] == "no space left on device"
    assert (calls("left"), calls("right")) == (0, 1)


def test_a_damaged_entry_costs_one_video(
    bench: Bench, dataset: Path, dataset_content: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    del dataset_content["left"]["occluded"]
    dataset.write_bytes(pickle.dumps({**dataset_content, "../up": dataset_content["right"]}))
    assert bench() == 1
    said = capsys.readouterr().err
    assert "video left of" in said
    assert "lacks one of the keys" in said
    assert "'../up' has a name that cannot be a file's" in said
    scores = json.loads(Path("out/report/scores.json").read_text())
    assert (list(scores["videos"]), sorted(scores["missing"])) == (["right"], ["../up", "left"])
    assert bench("--videos", "right") == 0


def test_a_damaged_shard_costs_its_videos(
    bench: Bench, dataset_content: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    shards = Path("kinetics")
    shards.mkdir()
    left = pickle.dumps([dataset_content["left"]])
    (shards / "0_of_3.pkl").write_bytes(left[: len(left) // 2])
    (shards / "1_of_3.pkl").write_bytes(pickle.dumps({"right": dataset_content["right"]}))
    (shards / "2_of_3.pkl").write_bytes(b"cposix\nsystem\n(Vtouch executed\ntR.")
    assert bench(of=shards) == 1
    said = capsys.readouterr().err
    assert "2 of 3 videos failed" in said
    assert "0_of_3.pkl is not readable as a TAP-Vid pickle" in said
    assert "2_of_3.pkl was refused, nothing in it executed" in said
    assert not Path("executed").exists()
    scores = json.loads(Path("out/report/scores.json").read_text())
    assert (list(scores["videos"]), scores["missing"]) == (["right"], ["0_of_3.pkl", "2_of_3.pkl"])
    assert bench("--videos", "right", of=shards) == 0  # what was asked for went well
    assert json.loads(Path("out/summary.json").read_text())["failed_before"] == ["0_of_3.pkl", "2_of_3.pkl"]
    assert bench("--videos", "0_of_3-0", of=shards) == 2
    assert "has no video 0_of_3-0; kinetics/0_of_3.pkl is not readable" in capsys.readouterr().err
    (shards / "0_of_3.pkl").write_bytes(left)
    (shards / "2_of_3.pkl").unlink()
    assert bench(of=shards) == 0
    assert (calls("0_of_3-0"), calls("right")) == (1, 1)


def test_of_shards_one_at_least_can_be_read(bench: Bench, capsys: pytest.CaptureFixture[str]) -> None:
    Path("kinetics").mkdir()
    Path("kinetics/0_of_1.pkl").write_bytes(b"half")
    assert bench(of="kinetics") == 2
    assert "0_of_1.pkl is not readable" in capsys.readouterr().err
    assert not Path("out").exists()


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("pointodyssey", dataset_files.write_pointodyssey),
        ("egopoints", dataset_files.write_egopoints),
        ("dynamic-replica", dataset_files.write_dynamic_replica),
        ("badja", dataset_files.write_badja),
    ],
)
def test_datasets_that_decomo_eval_scores_are_fitted(
    name: str, write: Callable[[Path], Any], bench: Bench, capsys: pytest.CaptureFixture[str]
) -> None:
    write(Path("data"))
    assert bench("--dataset", name, of="data") == 0
    assert "first, mean over 1 videos: AJ " in capsys.readouterr().out
    assert json.loads(Path("out/bench.json").read_text())["reader"] == name
    (metrics,) = json.loads(Path("out/report/scores.json").read_text())["videos"].values()
    assert any(figure.startswith(name.replace("-", "_")) for figure in metrics), "the benchmark's own"
    assert bench("--dataset", "folder", of="data") == 2
    assert "data is not of folder, which is a folder of <video>.npz" in capsys.readouterr().err


def test_one_folder_of_results_is_of_one_reader(bench: Bench, capsys: pytest.CaptureFixture[str]) -> None:
    dataset_files.write_pointodyssey(Path("data"))
    dataset_files.write_egopoints(Path("data"))
    assert bench(of="data") == 2
    assert "the files of pointodyssey and of egopoints; say which by --dataset" in capsys.readouterr().err
    assert bench("--dataset", "pointodyssey", of="data") == 0
    assert bench("--dataset", "egopoints", of="data") == 2
    assert "out was made with another reader; give another --out" in capsys.readouterr().err


def test_a_model_that_does_not_open_costs_one_video(bench: Bench, capsys: pytest.CaptureFixture[str]) -> None:
    Path("plan/left").write_text("is broken")
    assert bench() == 1
    assert "left: it cannot be scored (" in capsys.readouterr().err
    scores = json.loads(Path("out/report/scores.json").read_text())
    assert (list(scores["videos"]), scores["missing"]) == (["right"], ["left"])
    summary = json.loads(Path("out/summary.json").read_text())
    assert [[outcome["name"] for outcome in summary[how]] for how in ("finished", "failed")] == [["right"], ["left"]]
    assert summary["mean"] is not None


def test_no_model_may_open(bench: Bench) -> None:
    Path("plan/left").write_text("is broken")
    assert bench("--videos", "left") == 1
    assert not list(Path("out/report").iterdir())
    assert json.loads(Path("out/summary.json").read_text())["mean"] is None


def test_the_summary_is_of_all_that_is_there_whatever_is_asked_for(bench: Bench) -> None:
    Path("plan/left").write_text("fails")
    assert bench() == 1
    assert bench("--videos", "right") == 0  # what was asked for went well
    summary = json.loads(Path("out/summary.json").read_text())
    assert (summary["failed"], summary["failed_before"]) == ([], ["left"])
    assert json.loads(Path("out/report/scores.json").read_text())["missing"] == ["left"]
    Path("plan/left").unlink()
    assert bench("--videos", "left") == 0
    summary = json.loads(Path("out/summary.json").read_text())
    assert sorted(outcome["name"] for outcome in summary["finished"]) == ["left", "right"]
    assert sorted(json.loads(Path("out/report/scores.json").read_text())["videos"]) == ["left", "right"]


def test_estimates_are_of_as_many_as_there_is_room_for(
    bench: Bench, dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of eight that are submitted two run, as on a Ray of two CPUs."""

    class Small(LocalEngine):
        @contextmanager
        def start(self) -> Iterator[Room]:
            with super().start() as room:
                yield replace(room, fit=lambda: 2)

    summary = run.bench(dataset, "out", (), engine=Small(jobs=8))
    assert summary.jobs == 2
    assert {outcome.jobs for outcome in summary.finished} == {2}
    assert Room(8, Small().start, lambda: 0).at_a_time == 1  # pyright: ignore[reportArgumentType]


def test_a_fit_that_was_killed_goes_on_where_it_was(bench: Bench) -> None:
    """In the next attempt, and in the next run where it was the last one."""
    Path("plan/left").write_text("killed in the middle")
    assert bench("--videos", "left", "--attempts", "1") == 1
    assert bench("--videos", "left", "--attempts", "1") == 0
    assert calls("left") == 2
    Path("plan/right").write_text("killed in the middle")
    assert bench("--attempts", "2") == 0
    assert calls("right") == 2
    assert Path("out/videos/right/run/progress").is_file()


def test_a_fit_of_other_options_does_not_go_on(bench: Bench) -> None:
    Path("plan/left").write_text("killed in the middle")
    only = ("--videos", "left", "--attempts", "1")
    assert bench(*only) == 1
    assert bench(*only, "--seed", "1") == 1
    assert "--resume" not in json.loads(Path("arguments.json").read_text())


def test_a_run_that_does_not_go_on_is_begun_anew(bench: Bench) -> None:
    only = ("--videos", "left", "--attempts", "1")
    Path("plan/left").write_text("killed in the middle")
    assert bench(*only) == 1
    Path("plan/left").write_text("does not go on")
    assert bench(*only) == 1
    assert bench(*only) == 0
    assert calls("left") == 3


def test_a_fit_whose_export_failed_is_kept(bench: Bench) -> None:
    Path("plan/left").write_text("export fails")
    only = ("--videos", "left", "--attempts", "1")
    assert bench(*only) == 1
    Path("plan/left").unlink()
    (attempt,) = Path("out/videos/left").glob(".attempt-*")
    (attempt / "run" / "kept").touch()
    assert bench(*only) == 0
    assert Path("out/videos/left/run/kept").is_file()


def test_a_long_video_becomes_windows(bench: Bench) -> None:
    Path("plan/left").write_text("is long")
    assert bench("--videos", "left") == 0
    assert Path("out/models/left/windows.json").is_file()
    assert list(json.loads(Path("out/report/scores.json").read_text())["videos"]) == ["left"]
    assert bench("--videos", "left") == 0
    assert calls("left") == 1


def test_frames_are_fitted_at_the_resolution_asked_for(bench: Bench, capsys: pytest.CaptureFixture[str]) -> None:
    """A fit that fails leaves its frames."""
    Path("plan/left").write_text("fails")
    only = ("--videos", "left", "--attempts", "1")
    assert bench(*only, "--resolution", "256x256") == 1
    assert read_clip("out/videos/left/frames/left").frames.shape == (11, 256, 256, 3)
    Path("plan/left").unlink()
    assert bench(*only, "--resolution", "256x256") == 0
    assert bench(*only) == 2
    assert "out was made with another resolution; give another --out" in capsys.readouterr().err


def test_all_may_fail(bench: Bench) -> None:
    Path("plan/left").write_text("fails")
    assert bench("--videos", "left") == 1
    assert json.loads(Path("out/summary.json").read_text())["mean"] is None


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--preset", "paper"], "out was made with another options; give another --out"),
        (["--videos", "up"], "has no video up"),
        (["--engine", "slurm"], "'slurm' is not"),
        (["--address", "auto"], "--address and --gpus-per-task are for --engine ray"),
        (["--engine", "ray", "--gpus-per-task", "1.5"], "whole GPUs, or a share of one, not 1.5"),
    ],
)
def test_bad_input_is_one_sentence(
    bench: Bench, capsys: pytest.CaptureFixture[str], options: list[str], words: str
) -> None:
    assert bench("--videos", "right") == 0
    assert bench(*options) == 2
    assert words in capsys.readouterr().err
    assert calls("right") == 1


def test_a_place_that_cannot_be_written_is_found_first(
    bench: Bench, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    assert bench("--out", str(tmp_path / "file" / "out")) == 2
    assert capsys.readouterr().err.startswith(f"Error: --out {tmp_path / 'file' / 'out'} cannot be written")
    assert not Path("calls").exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--preset", "cup"], "preset 'cup' is unknown"),
        (["--set", "optim.point=32"], "there is no key optim.point"),
        (["--time-budget", "10x"], "'10x' is not a duration"),
        (["--time-budget", "1m", "--steps", "5"], "give --time-budget or --steps, not both"),
    ],
)
def test_options_that_no_fit_would_take_claim_nothing(
    bench: Bench, capsys: pytest.CaptureFixture[str], options: list[str], words: str
) -> None:
    assert bench(*options) == 2
    assert words in capsys.readouterr().err
    assert not Path("out").exists()


def test_a_folder_without_a_model_takes_other_options(bench: Bench) -> None:
    Path("plan/left").write_text("fails")
    only = ("--videos", "left", "--attempts", "1")
    assert bench(*only) == 1
    assert bench(*only, "--seed", "1") == 1
    assert json.loads(Path("out/bench.json").read_text())["options"][-2:] == ["--seed", "1"]


def test_two_runs_in_one_folder_are_kept_apart(bench: Bench, capsys: pytest.CaptureFixture[str]) -> None:
    with alone(Path("out"), "decomo-bench", EvalError):
        assert bench() == 2
    assert "another decomo-bench is at work in out; wait for it" in capsys.readouterr().err


def test_a_failed_score_leaves_the_summary(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    def mixed(*_: Any, **__: Any) -> None:
        raise PredictionError("left was tracked at 256x256 but right at another size")

    monkeypatch.setattr(run, "evaluate", mixed)
    assert bench("--videos", "left") == 2
    summary = json.loads(Path("out/summary.json").read_text())
    assert [outcome["name"] for outcome in summary["finished"]] == ["left"]
    assert summary["mean"] is None


def test_what_cannot_be_removed_fails_no_finished_video(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a shared folder, of files that are still open something stays."""
    remove = shutil.rmtree

    def busy(path: Path, ignore_errors: bool = False) -> None:
        if not ignore_errors:
            raise OSError("Directory not empty")
        remove(path, ignore_errors=True)

    monkeypatch.setattr(shutil, "rmtree", busy)
    assert bench("--videos", "left", "--attempts", "1") == 0


def test_the_model_of_a_lost_attempt_counts(dataset: Path, tmp_path: Path) -> None:
    class Lossy:
        @contextmanager
        def start(self) -> Iterator[Room]:
            yield Room(1, lost)

    def lost(one: Any, _: int) -> Future[Outcome]:
        one.model.parent.mkdir(parents=True)
        one.model.touch()
        future: Future[Outcome] = Future()
        future.set_exception(OSError("the worker died"))
        return future

    videos = read_dataset(dataset)
    (outcome,) = run._fits(videos, run._tasks(["left"], tmp_path / "out", (), 1)[0]).run(Lossy()).finished
    assert (outcome.attempts, outcome.error) == (1, None)


@pytest.mark.parametrize("name", ["../up", ".hidden", "a/b", ""])
def test_names_that_are_no_files_are_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be a file's"):
        ClipTask(name, tmp_path, "clip", (), 1)


def test_cores_are_shared_out_or_given(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "0,1")
    monkeypatch.setattr(os, "cpu_count", lambda: 7)
    assert bench("--videos", "left", "--jobs", "3") == 0
    assert bench("--videos", "right", "--cpus-per-task", "5") == 0
    assert (Path("calls/left/0").read_text(), Path("calls/right/0").read_text()) == ("2 0,1", "5 0,1")


def test_an_attempt_given_up_for_lost_spoils_nothing(bench: Bench, dataset: Path, tmp_path: Path) -> None:
    """It goes on writing where it was; the next one works in another folder, and does away with the first."""
    ((left,), _) = run._tasks(["left"], tmp_path / "out", ("--preset", "cpu"), 2)
    write_frames(read_dataset(dataset)["left"], Path(left.source))
    lost = left.folder / ".attempt-lost"
    (lost / "run").mkdir(parents=True)
    assert left.attempt(2, Place(threads=1)).error is None
    assert left.model.is_file()
    assert sorted(file.name for file in left.folder.iterdir()) == ["frames", "log.txt", "made.json", "run"]


def test_what_ray_is_told_by_the_environment_is_taken_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where it does not start; what the user has said stays."""
    pytest.importorskip("ray", reason="needs Ray: pip install 'decomotion[ray]'")
    said, other, *_ = ENVIRONMENT
    monkeypatch.setenv(said, "mine")
    monkeypatch.delenv(other, raising=False)
    before, seen = dict(os.environ), {}

    def does_not_start(**options: object) -> None:
        seen.update(os.environ)
        raise ConnectionError("no")

    monkeypatch.setattr("ray.init", does_not_start)
    with pytest.raises(EngineError, match="Ray does not answer at local"), RayEngine("local").start():
        pass
    assert (seen[said], seen[other]) == ("mine", ENVIRONMENT[other])
    assert dict(os.environ) == before


def test_a_worker_without_a_gpu_keeps_its_own_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It may be lent to an attempt with one next; the commands see none."""
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "0,1")
    seen = []
    monkeypatch.setattr(
        job, "_run", lambda line, log, environment, _: seen.append(environment["CUDA_VISIBLE_DEVICES"]) or 1
    )
    left = ClipTask("left", tmp_path / "out", str(tmp_path), (), attempts=1)
    for on_gpu in (False, True):
        cluster._attempt(left, 1, 1, on_gpu)
    assert seen == ["", "0,1"]
    assert os.environ["CUDA_VISIBLE_DEVICES"] == "0,1"


def test_a_folder_that_machines_do_not_share_is_named(tmp_path: Path) -> None:
    outcome = ClipTask("left", tmp_path / "out", str(tmp_path / "left"), (), attempts=1).attempt(1, Place(threads=1))
    assert "left is not there on" in str(outcome.error)
    assert "it has to be in a folder that all machines share" in str(outcome.error)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # of a Ray that could not start
def test_a_ray_worker_killed_in_the_middle_costs_one_attempt_of_one_video(
    bench: Bench, dataset: Path, dataset_content: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    """Two workers, four videos; `right` runs while the worker of `left` is killed, and ends after the retry began."""
    pytest.importorskip("ray", reason="needs Ray: pip install 'decomotion[ray]'")
    more = {"up": dataset_content["left"], "down": dataset_content["right"]}
    dataset.write_bytes(pickle.dumps(dataset_content | more))
    Path("plan/left").write_text("kills its worker once")
    Path("plan/right").write_text("waits for left")
    code = bench("--engine", "ray", "--address", "local", "--jobs", "2")
    if "timed out during startup" in capsys.readouterr().err:
        pytest.skip(TOO_BUSY)
    assert code == 0
    expected = {"left": 2, "right": 1, "up": 1, "down": 1}
    assert {video: calls(video) for video in expected} == expected
    finished = json.loads(Path("out/summary.json").read_text())["finished"]
    assert {outcome["name"]: outcome["attempts"] for outcome in finished} == expected
    orphan = Path("/proc") / Path("orphan").read_text()
    for _ in range(300):  # the fit of the worker that was killed
        if not orphan.exists():
            break
        time.sleep(0.1)
    assert not orphan.exists()


@pytest.mark.slow
def test_a_ray_reached_by_its_address(bench: Bench, ray_address: str, capsys: pytest.CaptureFixture[str]) -> None:
    on_ray = ("--engine", "ray", "--address", ray_address)
    assert bench(*on_ray, "--cpus-per-task", "99") == 2
    assert "no node of the Ray cluster has 99 CPUs and 0 GPUs; ask for less" in capsys.readouterr().err
    Path("plan/left").write_text("kills its worker once")
    Path("plan/right").write_text("fails")
    assert bench(*on_ray, "--attempts", "2", "--jobs", "8") == 1
    assert (calls("left"), calls("right")) == (2, 2)
    assert Path("calls/left/1").read_text() == "1 "  # no GPU was reserved, none is seen
    summary = json.loads(Path("out/summary.json").read_text())
    assert summary["jobs"] == 2  # what has room
    assert summary["finished"][0]["jobs"] == 2
    assert [outcome["name"] for outcome in summary["failed"]] == ["right"]
    assert bench(*on_ray, "--videos", "left") == 0  # Ray is still there, and left is done
    assert calls("left") == 2


def test_a_silent_address_is_one_sentence(bench: Bench, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("ray", reason="needs Ray: pip install 'decomotion[ray]'")
    with socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{closed.getsockname()[1]}"
    assert bench("--engine", "ray", "--address", address) == 2
    assert f"Ray does not answer at {address} (" in capsys.readouterr().err


def test_absent_ray_is_one_sentence(
    bench: Bench, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    assert bench("--engine", "ray") == 2
    assert "--engine ray needs Ray; run: pip install 'decomotion[ray]'" in capsys.readouterr().err

"""Many clips with stand-ins for the commands: what is done, redone, refused and told; and one that is fitted."""

from __future__ import annotations

import json
import pickle
import re
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from children import FIT_SECONDS, SECONDS, child, named_in
from decomo_runtime import Tracker, Tracks
from decomotion.batch import task
from decomotion.batch.cli import main
from decomotion.clip import Clip, read_clip
from decomotion.errors import BatchError
from decomotion.jobs.lock import alone
from tiny_fit import AFFINE, TINY_CPU, texture, write_frames

STAND_IN = """
import os, pathlib, shutil, signal, sys
root = pathlib.Path({root!r})
stage, *given = sys.argv[1:]
places = dict(export=0, picture=1)
out = pathlib.Path(given[places[stage] if stage in places else given.index("--out") + 1])
name = out.stem if stage == "export" else out.parts[-3]
with (root / "calls").open("a") as file:
    print(name, stage, *given, file=file)
order = root / "plan" / (name + "-" + stage)
if order.exists():
    if stage == "train":
        from decomotion.config import load
        from decomotion.record import Record
        from decomotion.schedule import Budget
        Record("digest", load("cpu"), 0, Budget(1)).write(out)
    if order.read_text() == "killed":
        order.unlink()
        os.kill(os.getpid(), signal.SIGKILL)
    print("Error: no such luck")
    sys.exit(1)
if stage == "train":
    out.mkdir(exist_ok=True)
else:
    out.write_text(stage)
if "--overlay" in given:
    pathlib.Path(given[given.index("--overlay") + 1]).touch()
"""

Batch = Callable[..., int]


@pytest.fixture
def clips(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two folders of frames, in a working directory of their own."""
    monkeypatch.chdir(tmp_path)
    for seed, name in enumerate(("one", "two <b>")):
        write_frames(sliding(seed), tmp_path / "clips" / name)
    return tmp_path / "clips"


@pytest.fixture
def batch(clips: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Batch:
    """Runs decomo-batch; a file `plan/<clip>-<stage>` makes a stage fail."""
    (tmp_path / "plan").mkdir()
    stand_in = ("-c", STAND_IN.format(root=str(tmp_path)))
    monkeypatch.setattr(task, "COMMANDS", {stage: (*stand_in, stage) for stage in task.COMMANDS})
    return lambda *options, of="clips": main([str(of), "--out", "out", *options])


def sliding(seed: int, frames: int = 9) -> Clip:
    picture = texture(np.random.default_rng(seed), 28, 40 + frames, grain=1.5)
    return Clip("sliding", np.stack([picture[:, place : place + 40] for place in range(frames)]), 24.0)


def calls(name: str) -> list[str]:
    """The stages that were begun for a clip since this was last asked."""
    lines = Path("calls").read_text().splitlines() if Path("calls").exists() else []
    return [line.removeprefix(f"{name} ").split()[0] for line in lines if line.startswith(f"{name} ")]


ALL = ["train", "export", "track", "picture"]


def test_every_clip_is_fitted_and_asked_once(batch: Batch, capsys: pytest.CaptureFixture[str]) -> None:
    assert batch("--jobs", "2", "--seed", "3") == 0
    assert "2 finished, 0 failed; wrote out/index.html" in capsys.readouterr().out
    assert calls("one") == calls("two <b>") == ALL
    told = Path("calls").read_text()
    assert re.search(r"^one train \S+/clips/one --out \S+/run --seed 3$", told, re.MULTILINE)
    assert re.search(r"^one track \S+/one.onnx --grid 16@0 --out \S+ --overlay \S+ --clip \S+/one$", told, re.MULTILINE)
    made = {str(file.relative_to("out")) for file in Path("out").rglob("*") if file.is_file() and "one" in str(file)}
    assert made == {
        *("models/one.onnx", "tracks/one.npz", "overlays/one.mp4"),
        *(f"videos/one/{name}" for name in ("asked.json", "log.txt", "made.json", "picture.jpg", "task.json")),
    }
    assert batch("--seed", "3") == 0
    assert calls("one") == ALL
    assert {each["attempts"] for each in json.loads(Path("out/summary.json").read_text())["finished"]} == {0}


@pytest.mark.parametrize(
    ("count", "given", "passed_on"),
    [(4, [], ""), (5, [], " --prepared drop"), (5, ["--prepared", "keep"], " --prepared keep")],
)
def test_what_many_clips_prepare_goes(count: int, given: list[str], passed_on: str, batch: Batch) -> None:
    lines = [f"clips/one,{name},--seed {number}" for number, name in enumerate("abcde"[:count])]
    Path("list.csv").write_text("\n".join(["clip,name,options", *lines]))
    assert batch(*given, of="list.csv") == 0
    fits = [line for line in Path("calls").read_text().splitlines() if " train " in line]
    assert [re.sub(".* --seed .", "", line) for line in fits] == [passed_on] * count
    assert batch("--prepared", "drop", of="list.csv") == 0  # decides nothing of what is made: there is nothing to do
    assert calls("a") == ALL


def test_other_points_are_asked_for_without_a_fit(batch: Batch) -> None:
    assert batch() == 0
    assert batch("--grid", "8@2") == 0
    assert calls("one") == [*ALL, "track", "picture"]
    Path("points.csv").write_text("t,x,y\n0,3,4\n")
    Path("list.csv").write_text("clip,queries\nclips/one,points.csv\n")
    assert batch("--grid", "8@2", of="list.csv") == 0
    assert batch("--grid", "4@2", of="list.csv") == 0  # of other clips
    assert calls("one")[6:] == ["track", "picture"]
    Path("points.csv").write_text("t,x,y\n0,3,5\n")
    assert batch("--no-overlay", of="list.csv") == 0
    assert calls("one")[8:] == ["track", "picture"]
    assert "--queries" in Path("calls").read_text().splitlines()[-2]
    assert "--overlay" not in Path("calls").read_text().splitlines()[-2]
    assert set(json.loads(Path("out/videos/one/task.json").read_text())["seconds"]) == set(ALL)


def test_one_bad_clip_does_not_stop_the_others(batch: Batch, clips: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("plan/one-train").write_text("fails")
    (clips / "absent").symlink_to("nowhere.mp4")
    Path("list.txt").write_text("clips/absent.mp4\nclips/one\nclips/two <b>\n")
    assert batch(of="list.txt") == 1
    said = capsys.readouterr().err
    assert "one: train ended with exit code 1: Error: no such luck" in said
    assert "2 of 3 clips failed" in said
    assert "absent: [Errno 2] No such file" in said
    assert calls("one") == ["train", "train"]
    assert calls("two <b>") == ALL
    page = Path("out/index.html").read_text()
    assert "Clips: 1 finished, 2 failed" in page
    assert "Error: no such luck" in page
    assert "<b>" not in page
    assert "two &lt;b&gt;" in page
    assert 'href="models/two%20%3Cb%3E.onnx"' in page
    Path("plan/one-train").unlink()
    Path("list.txt").write_text("clips/one\n")
    assert batch(of="list.txt") == 0
    assert calls("two <b>") == ALL
    summary = json.loads(Path("out/summary.json").read_text())  # of all that is there
    assert [each["name"] for each in summary["finished"]] == ["one", "two <b>"]
    assert summary["failed_before"] == ["absent"]


def test_a_killed_fit_goes_on(batch: Batch) -> None:
    Path("plan/one-train").write_text("killed")
    assert batch("--seed", "3") == 0
    first, second = re.findall(r"^one train .*$", Path("calls").read_text(), re.MULTILINE)
    assert (first.split()[-2:], second.split()[-3:]) == (["--seed", "3"], ["--seed", "3", "--resume"])


def test_tracks_that_fail_cost_no_fit(batch: Batch) -> None:
    Path("plan/one-track").write_text("fails")
    assert batch("--attempts", "1") == 1
    assert Path("out/models/one.onnx").is_file()
    Path("plan/one-track").unlink()
    assert batch() == 0
    assert calls("one") == [*ALL[:3], "track", "picture"]


def test_other_settings_are_refused(batch: Batch, clips: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert batch("--steps", "5") == 0
    assert batch("--steps", "6") == 2
    assert "out was made with another options; give another --out" in capsys.readouterr().err
    settings = Path("out/batch.json").read_text()
    for damaged in ("", settings[:7], "[]"):
        Path("out/batch.json").write_text(damaged)
        assert batch("--steps", "5") == 2
        sentence = "Error: {} is damaged and does not tell what the models there were made with; give another --out\n"
        assert capsys.readouterr().err == sentence.format(Path("out/batch.json"))
    Path("out/batch.json").write_text(settings)
    Path("list.csv").write_text("clip,options\nclips/one,--seed 4\nclips/two <b>,\n")
    assert batch("--steps", "5", of="list.csv") == 1
    assert "one.onnx was fitted with other options; move it away to fit it anew" in capsys.readouterr().err
    (clips / "one" / "00003.png").write_bytes((clips / "one" / "00004.png").read_bytes())
    assert batch("--steps", "5") == 1
    assert "one.onnx was fitted to other frames than the clip has now; move it away" in capsys.readouterr().err
    Path("out/models/one.onnx").unlink()
    assert batch("--steps", "5") == 0
    assert calls("one") == [*ALL, *ALL]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--grid", "16"], "--grid 16 is not STEP@T"),
        (["--set", "optim.point=32"], "there is no key optim.point"),
        (["--masks", "clips"], "--masks of one clip: give that in a list"),
        (["--time-budget", "1m", "--steps", "5"], "give --time-budget or --steps, not both"),
        (["--address", "auto"], "--address and --gpus-per-task are for --engine ray"),
    ],
)
def test_bad_input_is_one_sentence(
    batch: Batch, capsys: pytest.CaptureFixture[str], options: list[str], words: str
) -> None:
    assert batch(*options) == 2
    assert words in capsys.readouterr().err
    assert not Path("out").exists()


def test_two_runs_in_one_folder_are_kept_apart(batch: Batch, capsys: pytest.CaptureFixture[str]) -> None:
    with alone(Path("out"), "decomo-batch", BatchError):
        assert batch() == 2
    assert "another decomo-batch is at work in out; wait for it" in capsys.readouterr().err


def test_a_task_travels_to_another_machine(tmp_path: Path) -> None:
    one = task.TrackedTask("one", tmp_path, str(tmp_path), ("--seed", "3"), 2, queries=tmp_path / "points.csv")
    assert pickle.loads(pickle.dumps(one)) == one


@pytest.mark.slow
def test_on_ray(batch: Batch, ray_address: str, capsys: pytest.CaptureFixture[str]) -> None:
    """A fit that is killed goes on, and a clip that fails costs no other."""
    on_ray = ("--engine", "ray", "--address", ray_address, "--jobs", "8")
    Path("plan/one-train").write_text("killed")
    Path("plan/two <b>-track").write_text("fails")
    assert batch(*on_ray) == 1
    assert "two <b>: track ended with exit code 1: Error: no such luck" in capsys.readouterr().err
    assert calls("one") == ["train", *ALL]
    assert calls("two <b>") == ["train", "export", "track", "track"]
    Path("plan/two <b>-track").unlink()
    assert batch(*on_ray) == 0
    assert (calls("one"), calls("two <b>")[4:]) == (["train", *ALL], ["track", "picture"])
    assert json.loads(Path("out/summary.json").read_text())["jobs"] == 2  # what has room
    assert "Clips: 2 finished" in Path("out/index.html").read_text()


INTERRUPTED = """
import sys
from decomotion.batch.cli import main
from decomotion.jobs import engine
engine.PATIENCE = 0
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.slow
def test_clips_are_fitted_interrupted_and_gone_on_with(clips: Path, tmp_path: Path) -> None:
    """The commands themselves. The one that is interrupted ends the fit that it had begun, which saves itself."""
    (clips / "broken.mp4").write_bytes(b"no video")
    (tmp_path / "list.txt").write_text("clips/two <b>\nclips/broken.mp4\n")
    settings = [part for override in (*TINY_CPU, *AFFINE) for part in ("--set", override)]
    line = [
        "list.txt",
        "--out",
        "out",
        "--grid",
        "8@0",
        "--shots",
        "ignore",
        "--steps",
        "200",
        "--cpus-per-task",
        "1",
        *settings,
    ]
    videos = Path("out/videos/two <b>")
    with child([sys.executable, "-c", INTERRUPTED, *line], seconds=FIT_SECONDS) as run:
        while run.poll() is None and not list(videos.glob(".attempt-*/run/checkpoint.pt")):
            time.sleep(0.1)
        run.send_signal(signal.SIGINT)  # of the command alone, as no terminal does it
        run.communicate(timeout=SECONDS)
    assert run.returncode == 130
    assert named_in(str(tmp_path)) == []
    (attempt,) = videos.glob(".attempt-*")
    assert 0 < step_of(attempt / "run") < 200
    assert main([*line, "--attempts", "1"]) == 1
    assert step_of(videos / "run") == 200
    assert json.loads((videos / "task.json").read_text())["attempts"] == 1
    summary = json.loads(Path("out/summary.json").read_text())
    assert [[each["name"] for each in summary[how]] for how in ("finished", "failed")] == [["two <b>"], ["broken"]]
    assert Tracker("out/models/two <b>.onnx").quality is not None
    assert Tracks.load("out/tracks/two <b>.npz").xy.shape == (20, 9, 2)
    assert len(read_clip("out/overlays/two <b>.mp4")) == 9
    page = Path("out/index.html").read_text()
    assert page.count("data:image/jpeg;base64,") == 1
    assert "within 2 px" in page
    assert "does not decode as a video" in page
    assert "http" not in page


def step_of(run: Path) -> int:
    import torch

    from decomotion import checkpoint

    return checkpoint.load(run / "checkpoint.pt", torch.device("cpu")).training["step"]

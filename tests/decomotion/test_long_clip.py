"""Clips of several windows from the command line: what is fitted, kept, tried again, and refused."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from children import FIT_SECONDS, child, named_in
from decomo_runtime import Tracks
from decomotion import checkpoint, long_clip, record
from decomotion.cli import main
from decomotion.clip import Clip
from decomotion.config import load
from decomotion.errors import CheckpointError, ClipError
from decomotion.long_clip import ONE_WINDOW, USUAL, read_windows, windows_of
from decomotion.schedule import Budget
from decomotion.windows import FILE_NAME
from refitting import wait_until
from tiny_fit import AFFINE, TINY_CPU, texture, write_frames

SET_TINY = [part for override in (*TINY_CPU, *AFFINE) for part in ("--set", override)]
TINY_WINDOWS = ["--window", "8", *SET_TINY]

STAND_IN = """
import os, sys, pathlib
from decomotion.config import load
from decomotion.record import Record
from decomotion.schedule import Budget
source, _, out = sys.argv[1:4]
calls = pathlib.Path({calls!r})
calls.mkdir(exist_ok=True)
name = pathlib.Path(out).name
with (calls / name).open("a") as file:
    print(os.environ["OMP_NUM_THREADS"], *sys.argv[1:], file=file)
if (calls / f"fail-{{name}}").exists():
    print("Error: no such luck", file=sys.stderr)
    sys.exit(2)
Record("digest", load("cpu"), 0, Budget(1), finished=True).write(pathlib.Path(out))
(pathlib.Path(out) / "checkpoint.pt").touch()
"""


@pytest.fixture(autouse=True)
def in_an_empty_folder_without_a_gpu(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)


@pytest.fixture
def frames(tmp_path: Path) -> Path:
    return write_frames(sliding(20), tmp_path / "sliding")


def sliding(frames: int, seed: int = 0) -> Clip:
    """A picture that slides to the left, a pixel a frame."""
    picture = texture(np.random.default_rng(seed), 28, 40 + frames, grain=1.5)
    return Clip("sliding", np.stack([picture[:, place : place + 40] for place in range(frames)]), 24.0)


@pytest.fixture
def two_shots(tmp_path: Path) -> Path:
    """Eight frames of one picture that slides, then as many of another."""
    height, width = 84, 120
    pictures = [texture(np.random.default_rng(seed), height, width + 8, grain=1.5) for seed in (10, 20)]
    shown = [picture[:, place : place + width] for picture in pictures for place in range(8)]
    return write_frames(Clip("two", np.stack(shown), 24.0), tmp_path / "two")


@pytest.fixture
def calls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where a stand-in for the fit of a window, which only says that it is done, notes how it was called."""
    monkeypatch.setattr(long_clip, "COMMAND", ("-c", STAND_IN.format(calls=str(tmp_path / "calls"))))
    return tmp_path / "calls"


def of(number: int, frames: int = 300) -> Clip:
    return Clip("any", np.zeros((frames, 20, 30, 3), np.uint8), 24.0)


class TestWindows:
    def test_auto_keeps_what_is_not_long_in_one(self):
        assert len(windows_of(of(0, ONE_WINDOW), None, []).windows) == 1
        assert len(windows_of(of(0, ONE_WINDOW + 1), None, []).windows) == 2
        assert max(map(len, windows_of(of(0, 900), None, []).windows)) <= USUAL
        assert [len(window) for window in windows_of(of(0, 200), None, [100]).windows] == [100, 100]

    def test_they_tell_of_the_clip(self):
        frames = np.zeros((9, 20, 30, 3), np.uint8)
        clip = Clip("uneven", frames, times=np.arange(9) ** 1.5, pixel_aspect=2.0)
        layout = windows_of(clip, 8, [])
        assert (layout.clip, layout.num_frames, layout.height, layout.width) == ("uneven", 9, 20, 30)
        assert (layout.pixel_aspect, layout.times[4]) == (2.0, 8.0)

    def test_one_frame_is_no_shot(self):
        with pytest.raises(ClipError, match="a shot of one frame, 8, and motion needs at least two"):
            windows_of(of(0, 9), None, [8])


class TestCommand:
    def test_each_window_is_fitted_and_a_second_call_has_nothing_to_do(
        self, frames: Path, calls: Path, capsys: pytest.CaptureFixture[str]
    ):
        argv = [str(frames), "--window", "8", "--seed", "3", "--set", "optim.lr_field=0.01", "--time-budget", "60s"]
        assert main(argv) == 0
        assert capsys.readouterr().out == "fitted sliding (20 frames of 40x28) in 3 windows: runs/sliding\n"
        layout, _, options = read_windows(Path("runs/sliding"))
        assert [(window.begin, window.end) for window in layout.windows] == [(0, 8), (6, 14), (12, 20)]
        said = (calls / "window-001").read_text().split()
        assert said[1] == f"{frames}@6:14"
        assert said[said.index("--out") + 1] == str(Path("runs/sliding/window-001").absolute())
        assert said[-6:] == [*options, "--time-budget", "20.0s"]
        assert options == ["--set", "optim.lr_field=0.01", "--seed", "3"]
        assert main(argv) == 0
        assert all(len(file.read_text().splitlines()) == 1 for file in calls.iterdir())

    def test_a_part_of_a_clip(self, frames: Path, calls: Path):
        assert main([f"{frames}@2:19", "--window", "8", "--steps", "1"]) == 0
        assert [(calls / f"window-00{n}").read_text().split()[1] for n in range(3)] == [
            f"{frames}@{part}" for part in ("2:9", "7:14", "12:19")
        ]

    def test_several_at_a_time_share_the_cores_and_the_time(
        self, frames: Path, calls: Path, monkeypatch: pytest.MonkeyPatch
    ):
        monkeypatch.setattr(os, "cpu_count", lambda: 4)
        assert main([str(frames), "--window", "8", "--jobs", "2", "--time-budget", "60s"]) == 0
        for name in ("window-000", "window-001", "window-002"):
            said = (calls / name).read_text().split()
            assert (said[0], said[-1]) == ("2", "30.0s")  # the third comes after both
            assert Path("runs/sliding", name, "log.txt").is_file()

    def test_a_window_that_fails_is_named_and_the_next_call_does_it_alone(
        self, frames: Path, calls: Path, capsys: pytest.CaptureFixture[str]
    ):
        calls.mkdir()
        (calls / "fail-window-001").touch()
        argv = [str(frames), "--window", "8", "--steps", "1", "--jobs", "2"]
        assert main(argv) == 1
        assert "1 of 3 windows failed, the same command tries them again (window-001: train" in capsys.readouterr().err
        assert len((calls / "window-001").read_text().splitlines()) == long_clip.ATTEMPTS
        (calls / "fail-window-001").unlink()
        assert main(argv) == 0
        assert [len((calls / f"window-00{n}").read_text().splitlines()) for n in range(3)] == [1, 3, 1]

    def test_finished_windows_go_on_where_more_is_asked_for(self, frames: Path, calls: Path):
        assert main([str(frames), "--window", "8", "--steps", "1", "--seed", "2"]) == 0
        assert main([str(frames), "--resume"]) == 0
        assert main([str(frames), "--resume", "--steps", "9"]) == 0
        first, second = (calls / "window-002").read_text().splitlines()
        assert first.endswith("--seed 2 --steps 1")
        assert second.endswith("--resume --steps 9")

    @pytest.mark.parametrize("other", [["--window", "12"], ["--seed", "1"], ["--shots", "ignore", "--preset", "paper"]])
    def test_a_folder_is_of_one_clip_and_one_configuration(
        self, other: list[str], frames: Path, calls: Path, capsys: pytest.CaptureFixture[str]
    ):
        assert main([str(frames), "--window", "8", "--steps", "1"]) == 0
        assert main([str(frames), "--window", "8", "--steps", "1", *other]) == 2
        assert "runs/sliding was begun with another" in capsys.readouterr().err
        assert main([str(frames), "--resume", "--seed", "1"]) == 2
        assert "leave out --seed" in capsys.readouterr().err

    def test_another_clip(self, frames: Path, calls: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
        assert main([str(frames), "--window", "8", "--steps", "1"]) == 0
        other = write_frames(sliding(20, seed=1), tmp_path / "other")
        assert main([str(other), "--out", "runs/sliding", "--window", "8", "--steps", "1"]) == 2
        assert "was begun with another" in capsys.readouterr().err

    def test_two_at_work_in_one_folder(self, frames: Path, calls: Path, capsys: pytest.CaptureFixture[str]):
        with long_clip.alone(Path("runs/sliding"), "decomo-train", CheckpointError):
            assert main([str(frames), "--window", "8", "--steps", "1"]) == 2
        assert "another decomo-train is at work in" in capsys.readouterr().err

    def test_files_of_the_whole_clip_do_not_fit_its_windows(self, frames: Path, capsys: pytest.CaptureFixture[str]):
        for option in ("--flow", "--masks", "--tracks"):
            assert main([str(frames), "--window", "8", option, str(frames)]) == 2
            assert f"{option} with several windows: files of the whole clip do not fit" in capsys.readouterr().err
        assert not Path("runs").exists()

    def test_a_network_draws_outlines_in_each(self, frames: Path, calls: Path, tmp_path: Path):
        """Tasks find its file, and a name that is none is left as it is."""
        network = Path("network.onnx")
        network.touch()
        for masks, told in (("network.onnx", network.absolute()), ("isnet", "isnet")):
            argv = [str(frames), "--window", "8", "--steps", "1", "--masks", masks, "--out", f"runs/{masks}"]
            assert main(argv) == 0
            said = (calls / "window-001").read_text().splitlines()[-1].split()
            assert said[said.index("--masks") + 1] == str(told)

    @pytest.mark.parametrize("length", ["7", "0", "-3", "many", "8.5"])
    def test_no_length_of_a_window(self, length: str, frames: Path, capsys: pytest.CaptureFixture[str]):
        assert main([str(frames), "--window", length]) == 2
        assert "is neither auto, all nor a number of frames from 8 on" in capsys.readouterr().err

    def test_a_run_of_the_whole_clip_takes_the_place_of_its_windows(self, frames: Path, calls: Path):
        assert main([str(frames), "--window", "8", "--steps", "1"]) == 0
        assert main([str(frames), "--window", "all", "--steps", "1", *SET_TINY]) == 0
        assert not Path("runs/sliding", FILE_NAME).exists()
        assert checkpoint.load(Path("runs/sliding/checkpoint.pt")).clip.num_frames == 20

    @pytest.mark.parametrize(
        ("windows", "given", "passed_on"),
        [
            (4, [], []),
            (5, [], ["--prepared", "drop"]),
            (5, ["--prepared", "keep"], []),
            (2, ["--prepared", "drop"], ["--prepared", "drop"]),
        ],
    )
    def test_what_many_windows_prepare_goes(
        self,
        windows: int,
        given: list[str],
        passed_on: list[str],
        tmp_path: Path,
        calls: Path,
        caplog: pytest.LogCaptureFixture,
    ):
        frames = write_frames(sliding(2 + 6 * windows), tmp_path / "long")
        with caplog.at_level("INFO", logger="decomotion"):
            assert main([str(frames), "--window", "8", "--steps", "1", *given]) == 0
        lines = [(calls / f"window-00{number}").read_text().split() for number in range(windows)]
        assert [line[line.index("1") + 1 :] for line in lines] == [passed_on] * windows
        said = "what a window prepares leaves the disk when it is finished (--prepared keep: stays)"
        assert (said in caplog.messages) == (windows == 5 and not given)
        assert read_windows(Path("runs/long"))[2] == []  # the same command with another goes on
        assert main([str(frames), "--resume", "--steps", "2", "--prepared", "drop"]) == 0
        again = (calls / "window-000").read_text().splitlines()[-1]
        assert again.endswith("--resume --steps 2 --prepared drop")


class TestShots:
    def test_stop_and_ignore(self, two_shots: Path, capsys: pytest.CaptureFixture[str]):
        assert main([str(two_shots), "--steps", "1", *SET_TINY]) == 2
        assert "two cuts to another shot at frame 8" in capsys.readouterr().err
        assert main([str(two_shots), "--steps", "1", "--shots", "ignore", *SET_TINY]) == 0
        assert checkpoint.load(Path("runs/two/checkpoint.pt")).clip.num_frames == 16

    def test_split(self, two_shots: Path, calls: Path):
        assert main([str(two_shots), "--shots", "split"]) == 0
        layout, *_ = read_windows(Path("runs/two"))
        assert [(window.begin, window.end) for window in layout.windows] == [(0, 8), (8, 16)]


@pytest.mark.slow
def test_fit_kill_go_on_export_and_track(frames: Path, capsys: pytest.CaptureFixture[str]):
    """Killed without a warning in the middle of the second window, with what it had begun, and given once more."""
    from decomo_export.cli import main as export
    from decomo_runtime.cli import main as track

    argv = [str(frames), "--steps", "40", *TINY_WINDOWS]
    second = Path("runs/sliding/window-001/checkpoint.pt")
    with child([sys.executable, "-m", "decomotion.cli", *argv], seconds=FIT_SECONDS) as fit:
        wait_until(second.is_file, FIT_SECONDS)
        fit.send_signal(signal.SIGKILL)
    first = Path("runs/sliding/window-000/checkpoint.pt").stat().st_mtime_ns
    wait_until(lambda: not named_in(str(frames)))  # the window's own process ends too, before it is done
    assert record.read_record(second.parent).finished is False  # type: ignore[union-attr]
    assert main(argv) == 0
    assert Path("runs/sliding/window-000/checkpoint.pt").stat().st_mtime_ns == first
    steps = [checkpoint.load(file).training["step"] for file in sorted(Path("runs/sliding").glob("*/checkpoint.pt"))]
    assert steps == [40, 40, 40]

    assert export(["sliding.onnx"]) == 2
    assert "runs/sliding is of 3 windows, a file each; give a folder for them" in capsys.readouterr().err
    assert export(["sliding"]) == 0
    names = sorted(path.name for path in Path("sliding").iterdir() if path.suffix != ".png")
    assert names == ["window-000.onnx", "window-001.onnx", "window-002.onnx", FILE_NAME]
    assert json.loads(Path("sliding", FILE_NAME).read_text())["num_frames"] == 20

    assert track(["sliding", "--grid", "12@3", "--out", "t.npz", "--overlay", "t.mp4", "--clip", str(frames)]) == 0
    tracks = Tracks.load("t.npz")
    assert tracks.xy.shape[1] == 20
    seen = ~tracks.occluded
    true = tracks.queries[:, None, 1:] - (tracks.frames - 3)[:, None] * np.array([1, 0])
    assert np.median(np.linalg.norm(tracks.xy - true, axis=-1)[seen]) < 1
    assert Path("t.mp4").is_file()


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        (
            [],
            "sliding: 20 frames of 40x28 in 3 windows of up to 8 frames, 1 at a time; 24 min in all, 8 min for each, "
            "preparation included, then about 1 min of export (--time-budget 30m gives each 10 min; less means fewer",
        ),
        (["--jobs", "2"], "2 at a time; 20 min in all, 10 min for each, preparation included, then about 1 min of exp"),
        (
            ["--jobs", "9", "--time-budget", "2h"],
            "8 frames, 3 at a time; 2 h 0 min in all, 2 h 0 min for each, preparation included, then about 1 min of "
            "export (--time-budget or --steps say otherwise; less means fewer steps",
        ),
        (["--time-budget", "3m"], "3 min in all, 60 s for each, prep"),
        (["--steps", "5"], "1 at a time; 5 steps (--time-budget or --steps say otherwise)"),
        (["--preset", "paper"], "1 at a time; as many steps as the preset has ("),
    ],
)
def test_what_will_be_done_is_said_first(
    argv: list[str], said: str, frames: Path, calls: Path, caplog: pytest.LogCaptureFixture
):
    with caplog.at_level("INFO", logger="decomotion"):
        assert main([str(frames), "--window", "8", *argv]) == 0
    assert said in caplog.messages[0]


def test_windows_that_are_begun_have_the_default_time_and_others_keep_theirs(frames: Path, calls: Path):
    argv = [str(frames), "--window", "8", "--preset", "omnimotion"]
    calls.mkdir()
    (calls / "fail-window-001").touch()
    assert main(argv) == 1
    first, _ = (calls / "window-001").read_text().splitlines()
    assert first.endswith("--preset omnimotion --time-budget 480.0s")
    (calls / "fail-window-001").unlink()
    assert main([str(frames), "--resume"]) == 0  # it is not begun yet: what it is begun with says of what kind it is
    assert (calls / "window-001").read_text().splitlines()[-1] == first
    config, begun = load("omnimotion"), Path("runs/sliding/window-002")
    record.Record("digest", config, 0, Budget(1, 60.0)).write(begun)
    assert main([str(frames), "--resume"]) == 0
    assert (calls / "window-002").read_text().splitlines()[-1].endswith("--window all --resume")


def test_windows_are_prepared_ahead_of_their_fits(
    frames: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    from decomotion import prepare_cli

    assert prepare_cli.main([str(frames), "--window", "8", "--preview", "sheet.png", *SET_TINY]) == 0
    said = capsys.readouterr().out
    assert [line.split(" (")[0] for line in said.splitlines() if line.startswith("prepared")] == [
        f"prepared sliding-window-00{number}" for number in range(3)
    ]
    assert sorted(path.name for path in Path().glob("*.png")) == [f"sheet-window-00{number}.png" for number in range(3)]
    monkeypatch.setattr("decomotion.data.prepare.making.build_links", lambda *_: pytest.fail("they are made again"))
    assert main([f"{frames}@6:14", "--steps", "1", *SET_TINY]) == 0


def test_who_looks_on_has_no_torch():
    code = "import sys, decomotion.cli, decomotion.long_clip; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], timeout=60, check=False).returncode == 0


def test_how_long_windows_are_where_nothing_is_said():
    """128 frames are one; of more each has a hundred at most, as many windows as that takes."""
    for frames, lengths in ((128, [128]), (129, [70, 71]), (300, [84] * 4)):
        assert [len(window) for window in windows_of(of(0, frames), None, []).windows] == lengths


def test_longer_windows_have_more_of_the_time(tmp_path: Path, calls: Path):
    """Of 27 frames, with those that they share, and 54 seconds."""
    frames = write_frames(sliding(21), tmp_path / "longer")
    assert main([str(frames), "--window", "8", "--time-budget", "54s"]) == 0
    said = [(calls / f"window-00{number}").read_text().split() for number in range(4)]
    assert [each[1].rpartition("@")[2] for each in said] == ["0:7", "5:12", "10:16", "14:21"]
    assert [each[-1] for each in said] == ["14.0s", "14.0s", "12.0s", "14.0s"]

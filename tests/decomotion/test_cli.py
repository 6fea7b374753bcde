"""`decomo-train` from the command line: one run from frames to a checkpoint, and bad input in one sentence."""

from __future__ import annotations

import errno
from pathlib import Path

import click
import pytest
import torch
from tensorboard.summary.writer.record_writer import RecordWriter

from decomotion import checkpoint
from decomotion.cli import command, main
from decomotion.clip import Clip
from decomotion.losses import LOSSES, Loss
from decomotion.options import Duration
from full_disk import writes_end_at
from interruption import Killed, ctrl_c, interruption, killed
from tiny_fit import TINY_CPU, TINY_PAPER, sliding_square, write_frames

SET_TINY = [part for override in TINY_CPU for part in ("--set", override)]


@pytest.fixture(autouse=True)
def in_an_empty_folder_without_a_gpu(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)


@pytest.fixture
def frames(tmp_path: Path) -> Path:
    return write_frames(sliding_square(), tmp_path / "sliding")


def refused(argv: list[object], capsys: pytest.CaptureFixture[str]) -> str:
    """Runs `argv`, which must fail as bad input and leave nothing behind; returns its one sentence."""
    assert main([str(part) for part in argv]) == 2
    assert list(Path.cwd().iterdir()) == []
    out, err = capsys.readouterr()
    assert out == ""
    return err


def test_from_frames_to_a_run(frames: Path, capsys: pytest.CaptureFixture[str]):
    assert main([str(frames), "--steps", "2", "--seed", "4", *SET_TINY]) == 0
    assert capsys.readouterr().out == "fitted sliding (8 frames of 40x28): runs/sliding\n"
    loaded = checkpoint.load(Path("runs/sliding/checkpoint.pt"))
    assert (loaded.training["step"], loaded.training["seed"]) == (2, 4)
    assert loaded.config.preset == "cpu"
    assert loaded.clip.num_frames == 8

    assert main([str(frames), "--resume", "--steps", "3"]) == 0
    assert checkpoint.load(Path("runs/sliding/checkpoint.pt")).training["step"] == 3


def test_a_budget_too_short_for_a_fit_ends_well_and_says_so(
    frames: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
):
    """On a machine so slow that what preparation leaves has room for one step."""
    monkeypatch.setattr("decomotion.schedule.MIN_SECONDS", 1e-3)
    assert main([str(frames), "--time-budget", "0.001s", *SET_TINY]) == 0
    said = caplog.records[-1].getMessage()
    assert said.startswith("the fit is starved: it took 1 step")
    assert said.endswith("Go on with decomo-train on the same clip with --resume --out runs/sliding --time-budget 1m")


def test_a_place_that_cannot_be_written_is_found_first(
    frames: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    (tmp_path / "file").touch()
    monkeypatch.setattr("decomotion.train.fit", lambda *_, **__: pytest.fail("it began"))
    said = refused([frames, "--steps", "2", "--out", tmp_path / "file" / "run"], capsys)
    assert said.startswith(f"Error: --out {tmp_path / 'file' / 'run'} cannot be written")


def test_a_full_disk_of_the_cache(frames: Path, tmp_path: Path, monkeypatch, capsys: pytest.CaptureFixture[str]):
    monkeypatch.setenv("DECOMO_CACHE", str(tmp_path / "cache"))
    with writes_end_at(8192):
        assert f"Error: {tmp_path / 'cache'}" in refused([frames, "--steps", "2", *SET_TINY], capsys).splitlines()[-1]


def test_a_full_disk_of_the_run(frames: Path, capsys: pytest.CaptureFixture[str]):
    assert main([str(frames), "--steps", "1", "--out", "../prepared", *SET_TINY]) == 0
    capsys.readouterr()
    with writes_end_at(4096):
        assert main([str(frames), "--steps", "2", *SET_TINY]) == 2
    assert capsys.readouterr().err.splitlines()[-1] == "Error: runs/sliding/checkpoint.pt: File too large"
    assert not list(Path("runs/sliding").rglob("*.partial*"))


@pytest.mark.parametrize("after", [0, 1, 3])
def test_a_full_disk_of_the_events(
    after: int, frames: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    written = RecordWriter.write
    events = iter(range(100))

    def write(self: RecordWriter, data: bytes) -> None:
        if next(events) >= after:
            raise OSError(errno.ENOSPC, "No space left on device")
        written(self, data)

    monkeypatch.setattr(RecordWriter, "write", write)
    assert main([str(frames), "--steps", "20", *SET_TINY]) == 2
    assert capsys.readouterr().err.splitlines()[-1] == "Error: runs/sliding/tensorboard: No space left on device"


def test_another_preset_folder_and_masks(frames: Path, tmp_path: Path):
    overrides = [part for override in TINY_PAPER for part in ("--set", override)]
    out = tmp_path / "mine"
    argv = [str(frames), "--preset", "paper", "--steps", "1", "--out", str(out), "--masks", "none", *overrides]
    assert main(argv) == 0
    config = checkpoint.load(out / "checkpoint.pt").config
    assert (config.preset, config.data.masks) == ("paper", "none")


def test_a_config_file_and_a_time_budget(frames: Path, tiny_run: Path):
    assert main([str(frames), "--config", str(tiny_run / "config.yaml"), "--time-budget", "1s"]) == 0
    training = checkpoint.load(Path("runs/sliding/checkpoint.pt")).training
    assert training["budget"]["seconds"] == 1


def test_the_cpu_preset_has_a_budget_by_default(frames: Path, monkeypatch: pytest.MonkeyPatch):
    asked: dict[str, object] = {}

    def fit(clip: Clip, out: Path | None, **options: object) -> Path:
        asked.update(options)
        return Path("runs/sliding")

    monkeypatch.setattr("decomotion.train.fit", fit)
    assert main([str(frames)]) == 0
    assert (asked["steps"], asked["time_budget"]) == (None, 600)
    assert main([str(frames), "--preset", "paper"]) == 0
    assert (asked["steps"], asked["time_budget"]) == (None, None)
    assert main([str(frames), "--steps", "9"]) == 0
    assert (asked["steps"], asked["time_budget"]) == (9, None)
    assert main([str(frames), "--resume"]) == 0
    assert (asked["steps"], asked["time_budget"], asked["resume"]) == (None, None, True)


def test_ctrl_c_says_how_to_go_on(frames: Path, caplog: pytest.LogCaptureFixture):
    with interruption(0, ctrl_c), caplog.at_level("INFO", logger="decomotion"):
        assert main([str(frames), "--steps", "5", *SET_TINY]) == 130
    assert "stopped at step 1" in caplog.text
    assert "--resume" in caplog.text
    assert main([str(frames), "--resume"]) == 0
    assert checkpoint.load(Path("runs/sliding/checkpoint.pt")).training["step"] == 5


def test_a_failed_optimisation_is_1_and_named(
    frames: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setitem(LOSSES, "distortion", Loss(lambda p, b: p.depths.sum() * float("nan")))
    assert main([str(frames), "--steps", "5", *SET_TINY]) == 1
    assert "Error: loss distortion is not a number at step 0; the batch is in" in capsys.readouterr().err


class TestRefused:
    def test_no_clip(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
        (tmp_path / "empty").mkdir()
        assert "empty holds no frames" in refused([tmp_path / "empty"], capsys)
        assert "nowhere does not exist" in refused([tmp_path / "nowhere"], capsys)

    def test_one_frame(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
        assert "has one frame" in refused([write_frames(sliding_square(1), tmp_path / "one")], capsys)

    @pytest.mark.parametrize(
        ("argv", "message"),
        [
            (["--steps", "5", "--time-budget", "5m"], "give --time-budget or --steps, not both"),
            (["--set", "optim.stepz=3"], "there is no key optim.stepz"),
            (["--set", "optim.steps=many"], "optim.steps: input should be a valid integer"),
            (["--resume", "--set", "optim.steps=3", "--steps", "3"], "configuration and seed; leave out --set\n"),
            (
                ["--resume", "--preset", "cpu", "--seed", "0", "--rebuild-cache"],
                "leave out --preset, --rebuild-cache, --s",
            ),
            (["--resume"], "checkpoint.pt does not exist; train first"),
            (["--config", "nowhere.yaml"], "nowhere.yaml does not exist"),
            (["--masks", "nowhere"], "mask folder nowhere does not exist"),
            (["--device", "cuda"], "torch sees no CUDA device"),
            (["--device", "toaster"], "--device toaster is not a device that torch knows"),
            (["--time-budget", "soon"], "'soon' is not a duration"),
            (["--steps", "0"], "0 is not in the range x>=1"),
            (["--preset", "gpu"], "'gpu' is not one of"),
            (["--seed", "-1"], "-1 is not in the range"),
        ],
    )
    def test_options(self, argv: list[str], message: str, frames: Path, capsys: pytest.CaptureFixture[str]):
        assert message in refused([frames, *argv], capsys)

    def test_another_clip_on_resume(self, tiny_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
        other = write_frames(sliding_square(5), tmp_path / "other")
        assert "was fitted to another clip" in refused([other, "--resume", "--out", tiny_run], capsys)


def test_what_was_prepared_is_dropped_and_made_again(
    frames: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second call has no time for all that the first prepared: its links are of other points."""
    monkeypatch.setenv("DECOMO_CACHE", str(tmp_path / "cache"))
    run, stages = tmp_path / "run", lambda: list((tmp_path / "cache").glob("*/links-*"))
    begin = [str(frames), "--out", str(run), "--steps", "1", *SET_TINY]

    def fitted() -> tuple[int, int]:
        training = checkpoint.load(run / checkpoint.FILE_NAME).training
        return training["step"], training["errors"].shape[1]

    assert main([*begin, "--prepared", "keep"]) == 0
    assert len(stages()) == 1
    with interruption(0, killed), pytest.raises(Killed):
        main([*begin, "--prepared", "drop"])
    assert len(stages()) == 1  # it goes on
    assert main([*begin, "--prepared", "drop"]) == 0
    assert not stages()
    step, points = fitted()
    monkeypatch.setattr("decomotion.data.prepare.inputs.Inputs.count", 100)
    assert main([str(frames), "--out", str(run), "--resume", "--steps", "3"]) == 0
    assert (step, fitted()[0]) == (1, 3)
    assert fitted()[1] < points
    assert len(stages()) == 1


class TestDuration:
    @pytest.mark.parametrize(
        ("text", "seconds"), [("90", 90), ("90s", 90), ("10m", 600), ("1.5h", 5400), (" 2m ", 120), ("0.5m", 30)]
    )
    def test_of(self, text: str, seconds: float):
        assert Duration().convert(text, None, None) == seconds

    @pytest.mark.parametrize("text", ["", "soon", "-5m", "0s", "5 minutes", "1h30m", "1e3", "m"])
    def test_none(self, text: str):
        with pytest.raises(click.BadParameter, match=r"is not a duration; write for example 90s, 10m or 1\.5h"):
            Duration().convert(text, None, None)


def test_words_of_an_option_are_shown_as_they_have_to_be_given(capsys: pytest.CaptureFixture[str]):
    """AUTO in the help would be refused where it is typed."""
    assert main(["--help"]) == 0
    assert "--window auto|all|N" in capsys.readouterr().out


def test_help_names_every_option_with_its_default(capsys: pytest.CaptureFixture[str]):
    assert main(["--help"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    for option in command.params:
        if option.name != "clip":
            assert option.opts[0] in text
    for default in ("runs/<clip name>", "default: 10m; of several windows", "default: auto", "default: 0"):
        assert default in text

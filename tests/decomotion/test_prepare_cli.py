"""`decomo-prepare` from the command line: where and how much, a sheet of pictures, and bad input in one sentence."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from decomotion.cli import command as train
from decomotion.data import prepare as preparation
from decomotion.data.prepare import making
from decomotion.data.preview import COLUMNS, ROWS, flow_colours
from decomotion.prepare_cli import command, main
from tiny_fit import FRAMES, HEIGHT, TINY_CPU, WIDTH, sliding_square, write_frames

SET_TINY = [part for override in TINY_CPU for part in ("--set", override)]


@pytest.fixture(autouse=True)
def in_an_empty_folder_without_a_gpu(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.setenv("DECOMO_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)


@pytest.fixture
def frames(tmp_path: Path) -> Path:
    return write_frames(sliding_square(), tmp_path / "sliding")


def test_prepares_and_says_where_and_how_much(frames: Path, capsys: pytest.CaptureFixture[str]):
    assert main([str(frames), *SET_TINY]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in lines] == [
        "links",
        "features",
        "motion",
        "prepared sliding (8 frames of 40x28)",
    ]
    assert "260 points a frame" in lines[-1]
    assert "flow at gaps 1, 2, 4" in lines[-1]
    folder = Path(lines[-1].rsplit(": ", 1)[1])
    assert folder.parent == preparation.cache_root()
    assert main([str(frames), *SET_TINY]) == 0
    *stages, last = capsys.readouterr().out.splitlines()
    assert last == lines[-1]
    for line, made in zip(stages, lines, strict=False):
        size, seconds = made.split(", ", 1)
        assert line == f"{size}, cached ({seconds})", "found, with the seconds that it took when it was made"


def test_decomo_train_finds_it(frames: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    from decomotion.cli import main as fit

    assert main([str(frames), *SET_TINY]) == 0

    def fail(*_: object) -> None:
        raise AssertionError("prepared already")

    monkeypatch.setattr(making, "build_links", fail)
    assert fit([str(frames), *SET_TINY, "--steps", "1"]) == 0


@pytest.mark.parametrize("masks", ["auto", "none"])
def test_a_sheet_of_pictures(frames: Path, masks: str):
    assert main([str(frames), *SET_TINY, "--masks", masks, "--preview", "sheet.png"]) == 0
    sheet = cv2.imread("sheet.png")
    assert sheet is not None
    # frames are 40x28: tiles 320x224
    assert sheet.shape[1] > len(COLUMNS) * 320
    assert min(ROWS, FRAMES) * 320 > sheet.shape[0] > min(ROWS, FRAMES) * 224
    assert len(np.unique(sheet.reshape(-1, 3), axis=0)) > 100


def test_options_that_the_commands_share_are_the_same():
    own = {"clip", "preview", "rebuild_cache", "device", "version"}
    shared = {option.name for option in command.params} - own
    assert shared <= {option.name for option in train.params}
    assert len(shared) == 15


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        (["--preview", "sheet.jpg"], "must end in .png"),
        (["--flow", "nowhere"], "--flow nowhere is no folder; give dis, raft-small, raft-large or one"),
        (["--flow", "raft-small", "--flow-weights", "nowhere.pth"], "--flow-weights nowhere.pth does not exist"),
        (["--flow-weights", "weights.pth"], "--flow-weights goes with --flow raft-small or raft-large"),
        (["--features", "aliked", "--feature-weights", "nowhere.pth"], "--feature-weights nowhere.pth does not exist"),
        (["--feature-weights", "weights.pth"], "feature_weights go with features aliked or dino"),
        (["--features", "hog"], "'hog' is not one of"),
        (["--tracks", "nowhere.npz"], "--tracks nowhere.npz does not exist"),
        (["--masks", "nowhere"], "mask folder nowhere does not exist"),
        (["--masks", "nowhere.onnx"], "--masks nowhere.onnx does not exist; give the file of IS-Net"),
        (["--prepare-budget", "soon"], "'soon' is not a duration"),
    ],
)
def test_refused_before_any_work(
    frames: Path, argv: list[str], message: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
):
    assert main([str(frames), "--preset", "cpu", *argv]) == 2
    out, err = capsys.readouterr()
    assert message in err
    assert out == ""
    assert len(err.splitlines()) == 1 or "Usage" in err
    assert not list(tmp_path.glob("cache/*/*"))


@pytest.mark.parametrize(
    ("argv", "library", "extra"),
    [
        (["--flow", "raft-small"], "torchvision", "raft"),
        (["--features", "dino"], "timm", "dino"),
        (["--preset", "paper"], "torchvision", "raft"),
        (["--preset", "paper", "--flow", "dis"], "timm", "dino"),
    ],
)
def test_an_extra_that_is_not_installed_is_named_before_any_work(
    frames: Path,
    argv: list[str],
    library: str,
    extra: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
):
    for module in [name for name in sys.modules if name.split(".")[0] == library]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.delitem(sys.modules, "decomotion.data.features.dino", raising=False)
    monkeypatch.setitem(sys.modules, library, None)
    assert main([str(frames), *argv]) == 2
    out, err = capsys.readouterr()
    assert f" need{'s' * (library == 'torchvision')} {library}, which is not installed; run: pip install " in err
    assert f"'decomotion[{extra}]'" in err
    assert len(err.splitlines()) == 1
    assert out == ""
    assert not list(tmp_path.glob("cache/*/*"))


def test_flow_is_coloured_by_its_direction_and_length():
    flow = np.array([[[0, 0], [4, 0], [-4, 0], [0, 2], [2, 0]]], np.float32)
    colours = flow_colours(flow)
    assert colours[0].tolist() == [[255, 255, 255], [255, 0, 0], [0, 255, 255], [191, 255, 128], [255, 128, 128]]
    assert (flow_colours(np.zeros((2, 3, 2), np.float32)) == 255).all()


def test_the_paper_preset_without_internet(
    frames: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
):
    def unreachable(*_: object, **__: object) -> None:
        raise OSError("no route")

    monkeypatch.setattr("torchvision.models._api.load_state_dict_from_url", unreachable)
    monkeypatch.setattr("decomotion.data.features.dino.urlopen", unreachable)
    monkeypatch.setattr("decomotion.data.features.dino.try_to_load_from_cache", lambda *_: None)
    assert main([str(frames), "--preset", "paper"]) == 2
    assert "raft-large cannot be downloaded" in capsys.readouterr().err
    assert main([str(frames), "--preset", "paper", "--flow", "dis"]) == 2
    assert "take --features densesift, which needs none" in capsys.readouterr().err
    assert not list(tmp_path.glob("cache/*/*"))


def test_a_user_s_folder_of_flow(
    frames: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    """Fields without motion: all points stay where they are."""
    for first in range(FRAMES):
        for second in range(FRAMES):
            np.save(tmp_path / f"{first}_{second}.npy", np.zeros((HEIGHT // 2, WIDTH, 2), np.float32))
    tiny = [part for override in TINY_CPU[1:] for part in ("--set", override)]
    assert main([str(frames), *tiny, "--flow", str(tmp_path)]) == 0
    assert "flow at gaps 1, 2, 4:" in capsys.readouterr().out
    (tmp_path / "3_4.npy").unlink()
    shutil.rmtree(tmp_path / "cache")
    monkeypatch.setattr("decomotion.data.links.stage.MatchStore", None)  # long work, which is not begun
    assert main([str(frames), *tiny, "--flow", str(tmp_path)]) == 2
    assert "lacks fields 3_4;" in capsys.readouterr().err


def test_help_names_every_option(capsys: pytest.CaptureFixture[str]):
    assert main(["--help"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    for option in command.params:
        if option.name != "clip":
            assert option.opts[0] in text

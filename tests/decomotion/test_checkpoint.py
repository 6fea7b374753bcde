"""Checkpoints: models come back exactly, and what is no checkpoint is refused in one sentence."""

from __future__ import annotations

import errno
import os
import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pytest
import torch

from decomotion import checkpoint
from decomotion.checkpoint import FILE_NAME, ClipFacts, latest_run, load, save
from decomotion.clip import Clip
from decomotion.config import load as load_config
from decomotion.errors import CheckpointError
from decomotion.model.fusion import DecoMotion
from decomotion.quality import Figures, GapFigures, Quality
from decomotion.source import code_version
from full_disk import writes_end_at
from tiny_fit import TINY_PRESETS, randomised, sliding_square, tiny_model

TRAINING = {"step": 7, "seed": 3, "errors": torch.arange(6.0)}


@pytest.fixture(params=["cpu", "paper"])
def model(request: pytest.FixtureRequest) -> DecoMotion:
    start = torch.eye(3, 4).repeat(8, 1, 1)
    start[:, 0, 3] = torch.arange(8)
    return randomised(tiny_model(request.param, frames=8, height=28, width=40, start=start))


@pytest.fixture
def path(model: DecoMotion, tmp_path: Path) -> Path:
    preset = "cpu" if model.config.static.field.kind == "grid" else "paper"
    config = load_config(preset, overrides=TINY_PRESETS[preset])
    path = tmp_path / "run" / FILE_NAME
    save(path, config, ClipFacts.of(sliding_square()), model, TRAINING)
    return path


def test_the_model_is_rebuilt_exactly(path: Path, model: DecoMotion):
    loaded = load(path)
    assert loaded.config.model == model.config
    assert loaded.model.plane == model.plane
    state, expected = loaded.model.state_dict(), model.state_dict()
    assert state.keys() == expected.keys()
    assert all(torch.equal(state[name], expected[name]) for name in expected)


def test_the_rebuilt_model_says_the_same(path: Path, model: DecoMotion):
    """Buffers that are not saved, such as the grids' extent, follow from what is."""
    rebuilt = load(path).model
    xy, frame = torch.tensor([[[3.0, 4.0], [20.0, 9.0]]]), torch.tensor([5])
    first, second = (each.cast(xy, each.condition(frame)) for each in (model, rebuilt))
    assert torch.equal(first.dynamic_canonical, second.dynamic_canonical)
    assert torch.equal(first.fused_colour(), second.fused_colour())


def test_facts_and_training_come_back(path: Path):
    loaded = load(path)
    clip = sliding_square()
    assert loaded.clip == ClipFacts("sliding", clip.digest(), 8, 28, 40, 24.0)
    assert (loaded.training["step"], loaded.training["seed"]) == (7, 3)
    assert torch.equal(loaded.training["errors"], TRAINING["errors"])


def test_times_and_pixels_of_an_unusual_clip_come_back(tmp_path: Path, model: DecoMotion):
    times = (0.0, 0.033, 0.067, 0.1, 0.2, 0.3, 0.4, 0.5)
    frames = sliding_square().frames
    clip = Clip("phone", frames, times=np.array(times), pixel_aspect=16 / 11)
    preset = "cpu" if model.config.static.field.kind == "grid" else "paper"
    config = load_config(preset, overrides=TINY_PRESETS[preset])
    save(tmp_path / FILE_NAME, config, ClipFacts.of(clip), model, TRAINING)
    found = load(tmp_path / FILE_NAME).clip
    assert found == ClipFacts("phone", clip.digest(), 8, 28, 40, 14.0, times, 16 / 11)


def test_a_file_from_before_clips_had_times(path: Path):
    content = torch.load(path, weights_only=True)
    del content["clip"]["times"], content["clip"]["pixel_aspect"]
    torch.save(content, path)
    assert load(path).clip == ClipFacts.of(sliding_square())


FIGURES = Figures(900, 0.3, 2.0, 0.05, 0.31, 0.8, 0.9, 0.95, 0.1)
QUALITY = Quality(7, "flow at gaps 1, 2 of 1, 2, 4: budget", FIGURES, FIGURES, None, (GapFigures(1, 1, FIGURES),))


def test_how_good_the_fit_is_comes_back(path: Path, model: DecoMotion):
    assert (load(path).thinned, load(path).quality) == (None, None)
    save(path, load(path).config, ClipFacts.of(sliding_square()), model, TRAINING, "no time", QUALITY)
    assert (load(path).thinned, load(path).quality) == ("no time", QUALITY)


def test_a_file_from_before_fits_were_measured(path: Path):
    content = torch.load(path, weights_only=True)
    assert load(path).code == code_version()
    del content["thinned"], content["quality"], content["code"]
    torch.save(content, path)
    assert (load(path).thinned, load(path).quality, load(path).code) == (None, None, None)


@pytest.mark.parametrize("damage", [{"quality": "{}"}, {"quality": 3}, {"thinned": 3}, {"code": 3}])
def test_damaged_figures(path: Path, damage: dict[str, object]):
    change(path, **damage)
    with pytest.raises(CheckpointError, match="is not a decomotion checkpoint, or is damaged"):
        load(path)


def test_no_code_is_in_it(path: Path):
    torch.load(path, weights_only=True)


def test_missing(tmp_path: Path):
    with pytest.raises(CheckpointError, match=r"checkpoint\.pt does not exist; train first"):
        load(tmp_path / FILE_NAME)


def cut(content: bytes) -> bytes:
    return content[: len(content) // 2]


@pytest.mark.parametrize(
    "damage",
    [cut, lambda content: b"", lambda content: b"no checkpoint", lambda content: content[200:]],
    ids=["cut", "empty", "text", "headless"],
)
def test_damaged(path: Path, damage: Callable[[bytes], bytes]):
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(CheckpointError, match=r"is not a decomotion checkpoint, or is damaged"):
        load(path)


@pytest.mark.parametrize(
    "content",
    [
        {"state_dict": {}},
        [1, 2],
        torch.zeros(3),
        {"format_version": checkpoint.FORMAT_VERSION},
        {"format_version": "new", "config": {}},
    ],
    ids=["another dict", "list", "tensor", "nothing else", "version of text"],
)
def test_foreign(tmp_path: Path, content: object):
    torch.save(content, tmp_path / FILE_NAME)
    with pytest.raises(CheckpointError, match="is not a decomotion checkpoint, or is damaged"):
        load(tmp_path / FILE_NAME)


def test_another_zip(tmp_path: Path):
    with zipfile.ZipFile(tmp_path / FILE_NAME, "w") as archive:
        archive.writestr("readme", "hello")
    with pytest.raises(CheckpointError, match="is not a decomotion checkpoint"):
        load(tmp_path / FILE_NAME)


def change(path: Path, **changes: Any) -> None:
    torch.save(torch.load(path, weights_only=True) | changes, path)


@pytest.mark.parametrize(("later", "remedy"), [(1, "upgrade it"), (-1, "fit the clip again")])
def test_another_format(path: Path, later: int, remedy: str):
    version = checkpoint.FORMAT_VERSION + later
    change(path, format_version=version)
    with pytest.raises(CheckpointError, match=f"has format {version} but this decomotion reads .*; {remedy}"):
        load(path)


def test_a_configuration_of_another_version_is_named(path: Path):
    config = torch.load(path, weights_only=True)["config"]
    config["optim"]["momentum"] = 0.9
    change(path, config=config)
    with pytest.raises(CheckpointError, match=r"checkpoint\.pt: optim\.momentum: extra inputs .*; fit the clip again"):
        load(path)


def test_other_facts(path: Path):
    change(path, clip={"name": "goat"})
    with pytest.raises(CheckpointError, match="is not a decomotion checkpoint, or is damaged"):
        load(path)


def test_weights_of_another_size(path: Path):
    model = torch.load(path, weights_only=True)["model"]
    name = next(name for name in model if name.endswith("head.bias"))
    change(path, model=model | {name: torch.zeros(99)})
    with pytest.raises(CheckpointError, match="is not a decomotion checkpoint, or is damaged"):
        load(path)


class Bomb:
    """Creates a file when it is unpickled."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[object, ...]:
        return os.mkdir, (str(self.mark),)


@pytest.mark.parametrize(
    "write",
    [torch.save, lambda content, path: path.write_bytes(pickle.dumps(content, protocol=2))],
    ids=["zip", "pickle"],
)
def test_code_is_refused_and_not_run(tmp_path: Path, write: Callable[[object, Path], object]):
    write({"format_version": checkpoint.FORMAT_VERSION, "config": Bomb(tmp_path / "mark")}, tmp_path / FILE_NAME)
    with pytest.raises(CheckpointError):
        load(tmp_path / FILE_NAME)
    assert not (tmp_path / "mark").exists()


def test_a_failed_save_leaves_the_former_one(path: Path, model: DecoMotion, monkeypatch: pytest.MonkeyPatch):
    former = path.read_bytes()

    def fail(content: object, file: BinaryIO) -> None:
        file.write(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(torch, "save", fail)
    with pytest.raises(KeyboardInterrupt):
        save(path, load(path).config, ClipFacts.of(sliding_square()), model, {})
    assert path.read_bytes() == former
    assert [file.name for file in path.parent.iterdir()] == [FILE_NAME]


def test_a_full_disk_is_an_error_that_names_the_checkpoint(path: Path, model: DecoMotion):
    former = path.read_bytes()
    with writes_end_at(4096), pytest.raises(OSError, match=f"{path}") as failure:
        save(path, load(path).config, ClipFacts.of(sliding_square()), model, {})
    assert failure.value.errno == errno.EFBIG
    assert path.read_bytes() == former
    assert [file.name for file in path.parent.iterdir()] == [FILE_NAME]


class TestLatest:
    def test_written_last(self, tmp_path: Path):
        for age, name in enumerate(["b", "a", "c"]):
            (tmp_path / name).mkdir()
            (tmp_path / name / FILE_NAME).touch()
            os.utime(tmp_path / name / FILE_NAME, (1000 - age, 1000 - age))
        (tmp_path / "empty").mkdir()
        assert latest_run(tmp_path) == tmp_path / "b"

    def test_of_several_windows_it_is_the_folder_of_all(self, tmp_path: Path):
        for age, name in enumerate(["long/window-001", "long/window-000", "short"]):
            (tmp_path / name).mkdir(parents=True)
            (tmp_path / name / FILE_NAME).touch()
            os.utime(tmp_path / name / FILE_NAME, (1000 - age, 1000 - age))
        assert latest_run(tmp_path) == tmp_path / "long"

    def test_none(self, tmp_path: Path):
        with pytest.raises(CheckpointError, match=r"there is no run in .*; train first"):
            latest_run(tmp_path)

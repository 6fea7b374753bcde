"""Masks `rigid-first`: what the static volume alone cannot explain is found, kept, and found again."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import torch

from decomotion import checkpoint, rigid
from decomotion.config import Config, load
from decomotion.data.pool import UNKNOWN_MOTION
from decomotion.data.prepare import prepare
from decomotion.errors import CheckpointError
from decomotion.schedule import Budget
from decomotion.train import fit
from interruption import ctrl_c, interruption
from tiny_fit import FRAMES, SIZE, TINY_CPU, on_square, sliding_square

CLIP = sliding_square()
STEPS = 50


def config(*overrides: str) -> Config:
    points = "data.pool.points_per_frame=1024"
    return load("cpu", overrides=(*TINY_CPU, points, "data.masks=rigid-first", *overrides))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return fit(CLIP, tmp_path_factory.mktemp("rigid") / "run", config=config(), steps=STEPS, progress=False)


def test_preparation_leaves_the_masks_open():
    assert (prepare(CLIP, config().data, progress=False).moving == UNKNOWN_MOTION).all()


def test_the_square_is_what_a_rigid_scene_cannot_explain(run: Path):
    pool = rigid.load_motion(run, prepare(CLIP, config().data, progress=False))
    truth = on_square(pool.points, np.arange(FRAMES)[:, None])
    moving = pool.moving == 1
    assert (truth & moving).sum() / (truth | moving).sum() > 0.6
    # its similarity follows it: 2 pixels a frame to the right, and a pixel is 2 / 32
    gap = np.arange(FRAMES) - FRAMES // 2
    np.testing.assert_allclose(pool.object[:, 0, 2], gap * -2 * 2 / SIZE, atol=0.1)


def test_the_static_volume_has_its_share_of_the_run(run: Path):
    alone = checkpoint.load(run / rigid.FOLDER / checkpoint.FILE_NAME)
    whole = checkpoint.load(run / checkpoint.FILE_NAME)
    assert alone.training["step"] == round(rigid.SHARE * STEPS)
    assert alone.training["step"] + whole.training["step"] == STEPS
    assert alone.config.model.volumes == "static"
    assert whole.config == config()


def test_the_static_volume_alone_is_regularised_as_in_the_whole_run():
    weights = {name: config().loss[name] for name in ("distortion", "depth_range")}
    assert rigid.rigid_config(config()).loss == {"flow_robust": 1.0, **weights}


def test_the_whole_run_goes_on_from_it(tmp_path: Path):
    run = fit(CLIP, tmp_path / "run", config=config("optim.lr_field=1e-9"), steps=1, progress=False)
    alone, whole = (checkpoint.load(run / part / checkpoint.FILE_NAME).model for part in (rigid.FOLDER, "."))
    field = "static.head.weight"
    torch.testing.assert_close(whole.state_dict()[field], alone.state_dict()[field], atol=1e-6, rtol=0)


def test_an_interrupted_rigid_stage_goes_on(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    """The same bits as without the interruption, whether its checkpoint is from the middle or not yet there."""
    straight = fit(CLIP, tmp_path / "straight", config=config(), steps=10, progress=False)
    broken = tmp_path / "broken"
    with interruption(0, ctrl_c), caplog.at_level("INFO"), pytest.raises(KeyboardInterrupt):
        fit(CLIP, broken, config=config(), steps=10, progress=False)
    assert f"--resume --out {broken} goes on" in caplog.text
    assert checkpoint.load(broken / rigid.FOLDER / checkpoint.FILE_NAME).training["step"] == 1
    early = tmp_path / "early"
    shutil.copytree(broken, early)
    shutil.rmtree(early / rigid.FOLDER)
    expected = checkpoint.load(straight / checkpoint.FILE_NAME)
    for folder in (broken, early):
        fit(CLIP, folder, resume=True, progress=False)
        found = checkpoint.load(folder / checkpoint.FILE_NAME)
        assert found.training["step"] == 8
        assert (folder / rigid.FOLDER / rigid.MOTION).is_file()
        for name, value in expected.model.state_dict().items():
            assert torch.equal(value, found.model.state_dict()[name]), name


def test_a_budget_given_on_resume_holds_in_the_stage_too(tmp_path: Path):
    with interruption(0, ctrl_c), pytest.raises(KeyboardInterrupt):
        fit(CLIP, tmp_path / "run", config=config(), steps=50, progress=False)
    run = fit(CLIP, tmp_path / "run", resume=True, steps=15, progress=False)
    steps = [checkpoint.load(run / part / checkpoint.FILE_NAME).training["step"] for part in (rigid.FOLDER, ".")]
    assert steps == [3, 12]


def test_a_resumed_run_has_the_same_masks(run: Path):
    before = (run / rigid.FOLDER / rigid.MOTION).read_bytes()
    fit(CLIP, run, resume=True, steps=STEPS + 1, progress=False)
    assert checkpoint.load(run / checkpoint.FILE_NAME).training["step"] == STEPS + 1 - round(rigid.SHARE * STEPS)
    assert (run / rigid.FOLDER / rigid.MOTION).read_bytes() == before
    (run / rigid.FOLDER / rigid.MOTION).rename(run / "elsewhere.npz")
    with pytest.raises(CheckpointError, match=r"motion\.npz is missing"):
        fit(CLIP, run, resume=True, steps=STEPS + 2, progress=False)
    (run / "elsewhere.npz").rename(run / rigid.FOLDER / rigid.MOTION)


@pytest.mark.parametrize(
    ("whole", "part"),
    [
        (Budget(100), Budget(20)),
        (Budget(2), Budget(1)),
        (Budget(100, 60.0), Budget(20, 10.0)),
        (Budget(10, 5.0), Budget(2, 0.2)),
    ],
)
def test_parts_of_a_budget(whole: Budget, part: Budget):
    assert whole.part(0.2, elapsed=10.0) == part

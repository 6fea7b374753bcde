"""A model of one volume: the fused one in which the other has no part, and without its weights."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from decomotion.losses import LOSSES, applicable
from decomotion.model.fusion import DecoMotion
from decomotion.model.readout import answer
from decomotion.previews import render_layers
from tiny_fit import offsets, randomised, tiny_model

FRAMES = 5
OTHER = {"static": "dynamic", "dynamic": "static"}
each_alone = pytest.mark.parametrize("volumes", ["static", "dynamic"])
both_presets = pytest.mark.parametrize("preset", ["cpu", "paper"])


def alone_and_fused(preset: str, volumes: str) -> tuple[DecoMotion, DecoMotion]:
    """A single volume, and the fused model of the same weights whose confidence leaves nothing to the other."""
    fused = randomised(tiny_model(preset), 0.05)
    with torch.no_grad():
        fused.static.head.weight[4] = 0
        fused.static.head.bias[4] = math.inf if volumes == "static" else -math.inf
    alone = tiny_model(preset, overrides=(f"model.volumes={volumes}",))
    missing = alone.load_state_dict(fused.state_dict(), strict=False).missing_keys
    assert missing == []
    return alone, fused


def some_points() -> tuple[Tensor, Tensor, Tensor]:
    xy = torch.rand(3, 7, 2, generator=torch.Generator().manual_seed(0)) * torch.tensor([31.0, 23.0])
    return xy, torch.tensor([0, 4, 2]), torch.tensor([4, 1, 3])


@each_alone
@both_presets
def test_it_predicts_what_the_fused_model_does(preset: str, volumes: str):
    alone, fused = alone_and_fused(preset, volumes)
    mine, its = (model.predict(*some_points(), offsets(model, some_points()[0])) for model in (alone, fused))
    shared = {"fused_xy", "fused_rgb", "motion_mask", *(name for name in vars(its) if name.startswith(volumes))}
    for name in shared:
        torch.testing.assert_close(getattr(mine, name), getattr(its, name))
    if volumes == "dynamic":
        torch.testing.assert_close(mine.acceleration, its.acceleration)
    assert mine.acceleration.any()
    assert all(value.isfinite().all() for value in vars(mine).values())


@each_alone
def test_it_answers_what_the_fused_model_does(volumes: str):
    queries = torch.tensor([[0.0, 15.0, 12.0], [4.0, 8.0, 5.0], [2.0, 31.0, 23.0]])
    frame, xy, frames = queries[:, 0].long(), queries[:, 1:], torch.arange(FRAMES)
    answers = []
    for model in alone_and_fused("cpu", volumes):
        everything = model.condition(frames)
        answers.append(answer(model, everything, xy, frame, frames))
    torch.testing.assert_close(answers[0].xy, answers[1].xy)
    torch.testing.assert_close(answers[0].occlusion, answers[1].occlusion)


@each_alone
@both_presets
def test_the_other_volume_is_not_built(preset: str, volumes: str):
    alone, fused = alone_and_fused(preset, volumes)
    left_out = {name for name in fused.state_dict() if name not in alone.state_dict()}
    belongs = (f"{OTHER[volumes]}.",) if volumes == "dynamic" else ("dynamic.", "feature_")
    assert left_out == {name for name in fused.state_dict() if name.startswith(belongs)}


@each_alone
def test_every_parameter_learns(volumes: str):
    model = randomised(tiny_model("cpu", overrides=(f"model.volumes={volumes}",)), 0.05)
    prediction = model.predict(*some_points(), offsets(model, some_points()[0]))
    generator = torch.Generator().manual_seed(1)
    total = sum((value * torch.randn(value.shape, generator=generator)).sum() for value in vars(prediction).values())
    assert isinstance(total, Tensor)
    total.backward()
    assert [name for name, p in model.named_parameters() if p.grad is None or not p.grad.any()] == []


def test_losses_of_a_volume_that_is_not_there_are_left_out():
    everything = dict.fromkeys(LOSSES, 1.0)
    either = {"flow_fused", "flow_robust", "photometric_fused", "scene_flow", "distortion", "depth_range"}
    assert applicable(everything, "fused") == everything
    assert set(applicable(everything, "static")) == either | {"flow_static", "photometric_static"}
    assert set(applicable(everything, "dynamic")) == either | {"flow_dynamic", "photometric_dynamic", "feature"}


def test_previews_show_the_other_volume_empty():
    """Fused, static, objects, static confidence, depth: without a static volume, black scene and black confidence."""
    picture = render_layers(tiny_model("cpu", overrides=("model.volumes=dynamic",)), 0)
    fused, static, objects, confidence, _ = np.split(picture, 5, axis=1)
    assert not static.any()
    assert not confidence.any()
    # the fused picture is darker where the ray is not yet opaque
    assert objects.any()
    assert (fused <= objects.astype(int) + 1).all()
    _, static, objects, confidence, _ = np.split(
        render_layers(tiny_model("cpu", overrides=("model.volumes=static",)), 0), 5, axis=1
    )
    assert static.any()
    assert (confidence == 255).all()
    assert (objects == 255).all()

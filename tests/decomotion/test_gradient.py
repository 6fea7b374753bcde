"""Gradients of batches: they add up, and what is recorded on a GPU is what is computed."""

from __future__ import annotations

import copy
from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from decomotion.data.batch import Batch
from decomotion.gradient import Accumulator, Terms
from decomotion.losses import LOSSES
from decomotion.model.fusion import DecoMotion
from tiny_fit import randomised, tiny_model

PAIRS, POINTS, FEATURE, SMOOTH_SHARE = 3, 8, 3, 0.25
both_presets = pytest.mark.parametrize("preset", ["cpu", "paper"])
Add = Callable[[Accumulator], list[Terms]]


def some_batch(seed: int, pairs: int = PAIRS) -> Batch:
    generator = torch.Generator().manual_seed(seed)

    def uniform(*shape: int) -> Tensor:
        return torch.rand(pairs, POINTS, *shape, generator=generator)

    xy = uniform(2) * torch.tensor([255.0, 191.0])
    moving = (uniform() < 0.5).float()
    return Batch(
        frame=torch.tensor([0, 4, 2])[:pairs],
        target_frame=torch.tensor([3, 1, 0])[:pairs],
        point=torch.zeros(pairs, POINTS, dtype=torch.int64),
        xy=xy,
        target_xy=xy + 4 * uniform(2) - 2,
        confidence=uniform(),
        rgb=uniform(3),
        feature=uniform(FEATURE),
        moving=moving,
        masked=torch.ones(pairs, POINTS),
        expected_xy=xy + 6 * uniform(2) - 3,
        expected_weight=uniform(),
    )


def offset(model: DecoMotion, seed: int, pairs: int = PAIRS) -> Tensor:
    return torch.rand(pairs, POINTS, model.config.samples, generator=torch.Generator().manual_seed(seed))


def some_steps(accumulator: Accumulator) -> list[Terms]:
    """Of different batches, weights, sizes and losses, as in the course of a fit."""
    everything = {name: 1 + 0.1 * number for number, name in enumerate(LOSSES)}
    fewer = {name: 2 * weight for name, weight in everything.items() if name not in ("flow_fused", "distortion")}
    given = [(0, PAIRS, everything), (1, PAIRS, everything), (2, 2, everything), (3, PAIRS, fewer)]
    model = accumulator.model
    return [
        accumulator.add(some_batch(seed, pairs), offset(model, seed, pairs), weights) for seed, pairs, weights in given
    ]


def gradients(model: DecoMotion) -> dict[str, Tensor]:
    return {name: parameter.grad.cpu() for name, parameter in model.named_parameters() if parameter.grad is not None}


def of(model: DecoMotion, device: str, recorded: bool) -> tuple[list[Terms], dict[str, Tensor]]:
    accumulator = Accumulator(copy.deepcopy(model).to(device), SMOOTH_SHARE, recorded)
    terms = [Terms(each.losses.cpu(), each.error.cpu()) for each in some_steps(accumulator)]
    return terms, gradients(accumulator.model)


def assert_alike(found: tuple[list[Terms], dict[str, Tensor]], expected: tuple[list[Terms], dict[str, Tensor]]) -> None:
    for mine, its in zip(found[0], expected[0], strict=True):
        torch.testing.assert_close(mine.losses, its.losses, rtol=1e-4, atol=1e-5)
        torch.testing.assert_close(mine.error, its.error, rtol=1e-4, atol=1e-2)
    assert found[1].keys() == expected[1].keys()
    for name, gradient in expected[1].items():
        scale = float(gradient.abs().max())
        torch.testing.assert_close(found[1][name], gradient, rtol=1e-3, atol=1e-3 * scale, msg=name)


@both_presets
def test_gradients_add_up(preset: str):
    model = randomised(tiny_model(preset, feature_size=FEATURE), 0.05)
    weights = {"flow_fused": 1.0, "distortion": 0.5}
    parts = []
    for seed in (0, 1):
        alone = Accumulator(copy.deepcopy(model), SMOOTH_SHARE)
        terms = alone.add(some_batch(seed), offset(model, seed), weights)
        assert terms.losses.shape == (2,)
        assert terms.error.shape == (PAIRS, POINTS)
        parts.append(gradients(alone.model))
    together = Accumulator(copy.deepcopy(model), SMOOTH_SHARE)
    for seed in (0, 1):
        together.add(some_batch(seed), offset(model, seed), weights)
    for name, gradient in gradients(together.model).items():
        torch.testing.assert_close(gradient, parts[0][name] + parts[1][name], msg=name)


def test_weights_weigh_their_own_loss():
    """In their order, whatever it is; the losses themselves are unweighted."""
    model = randomised(tiny_model("cpu", feature_size=FEATURE), 0.05)
    found = {}
    for order in (("flow_fused", "photometric_fused"), ("photometric_fused", "flow_fused")):
        weights = {"flow_fused": 2.0, "photometric_fused": 0.0 + 1e-6}
        accumulator = Accumulator(copy.deepcopy(model), SMOOTH_SHARE)
        terms = accumulator.add(some_batch(0), offset(model, 0), {name: weights[name] for name in order})
        found[order] = dict(zip(order, terms.losses.tolist(), strict=True)), gradients(accumulator.model)
    (one, its), (other, others) = found.values()
    assert one == pytest.approx(other)
    assert one["flow_fused"] > 1
    for name in its:
        torch.testing.assert_close(its[name], others[name], msg=name)


@pytest.mark.gpu
@both_presets
def test_what_is_recorded_is_what_is_computed(preset: str):
    model = randomised(tiny_model(preset, feature_size=FEATURE), 0.05)
    assert_alike(of(model, "cuda", recorded=True), of(model, "cuda", recorded=False))


@pytest.mark.gpu
@both_presets
def test_a_gpu_computes_what_a_cpu_does(preset: str):
    model = randomised(tiny_model(preset, feature_size=FEATURE), 0.05)
    assert_alike(of(model, "cuda", recorded=False), of(model, "cpu", recorded=False))

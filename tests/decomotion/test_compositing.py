"""Weights along rays: their sums, slow twins in nested loops, and the two ends of the static confidence."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from decomotion.compositing import (
    THICK,
    THIN,
    as_if_opaque,
    composite,
    composite_weights,
    fused_weights,
    static_share,
    thickened,
    transmittance,
)

BATCHES = [(), (4,), (2, 3)]
densities = st.floats(0, 100, width=32)
confidences = st.floats(0, 1, width=32)
SLACK = 1e-4
"""T is the exponential of a difference of sums of up to 800, which float32 keeps to 6e-5."""


def random_rays(batch: tuple[int, ...], samples: int = 7, seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    """Densities of both volumes and confidences, in double precision."""
    generator = torch.Generator().manual_seed(seed)
    static, dynamic, beta = torch.rand(3, *batch, samples, generator=generator, dtype=torch.float64)
    return 3 * static, 3 * dynamic, beta


@given(st.lists(densities, min_size=1, max_size=8))
def test_weights_sum_to_at_most_one(sigma: list[float]):
    weights = composite_weights(torch.tensor(sigma))
    assert (weights >= 0).all()
    assert weights.sum() <= 1 + SLACK


@given(st.lists(st.tuples(densities, densities, confidences), min_size=1, max_size=8))
def test_fused_weights_sum_to_at_most_one(samples: list[tuple[float, float, float]]):
    weights = fused_weights(*torch.tensor(samples).unbind(-1))
    assert (weights.static >= 0).all()
    assert (weights.dynamic >= 0).all()
    assert weights.static.sum() + weights.dynamic.sum() <= 1 + SLACK


@pytest.mark.parametrize("batch", BATCHES)
def test_weights_against_nested_loops(batch: tuple[int, ...]):
    sigma, *_ = random_rays(batch)
    weights = composite_weights(sigma)
    for ray in np.ndindex(batch):
        light = 1.0
        for k in range(7):
            alpha = 1 - math.exp(-sigma[*ray, k])
            assert weights[*ray, k].item() == pytest.approx(light * alpha, abs=1e-12)
            light *= 1 - alpha


@pytest.mark.parametrize("batch", BATCHES)
def test_fused_weights_against_equation_5(batch: tuple[int, ...]):
    static, dynamic, beta = random_rays(batch)
    weights = fused_weights(static, dynamic, beta)
    for ray in np.ndindex(batch):
        for k in range(7):
            attenuation = 0.0
            for l in range(k):  # noqa: E741
                attenuation += beta[*ray, l] * static[*ray, l] + (1 - beta[*ray, l]) * dynamic[*ray, l]
            light = math.exp(-attenuation)
            of_static = light * beta[*ray, k] * (1 - math.exp(-static[*ray, k]))
            of_dynamic = light * (1 - beta[*ray, k]) * (1 - math.exp(-dynamic[*ray, k]))
            assert weights.static[*ray, k].item() == pytest.approx(of_static.item(), abs=1e-12)
            assert weights.dynamic[*ray, k].item() == pytest.approx(of_dynamic.item(), abs=1e-12)


def test_full_confidence_is_the_static_volume_alone():
    static, dynamic, beta = random_rays((5,))
    weights = fused_weights(static, dynamic, torch.ones_like(beta))
    assert torch.equal(weights.static, composite_weights(static))
    assert not weights.dynamic.any()


def test_no_confidence_is_the_dynamic_volume_alone():
    static, dynamic, beta = random_rays((5,))
    weights = fused_weights(static, dynamic, torch.zeros_like(beta))
    assert torch.equal(weights.dynamic, composite_weights(dynamic))
    assert not weights.static.any()


def test_two_equal_volumes_are_one():
    sigma, _, beta = random_rays((5,))
    weights = fused_weights(sigma, sigma, beta)
    torch.testing.assert_close(weights.static + weights.dynamic, composite_weights(sigma))


def test_transmittance_is_exclusive_of_the_sample_itself():
    sigma = torch.tensor([math.log(2), math.log(4), 100.0])
    torch.testing.assert_close(transmittance(sigma), torch.tensor([1.0, 1 / 2, 1 / 8]))
    # 1 - 1/2 of the light stops at the first sample, 3/4 of the rest at the second, all that is left at the last
    torch.testing.assert_close(composite_weights(sigma), torch.tensor([1 / 2, 3 / 8, 1 / 8]))


@pytest.mark.parametrize("batch", BATCHES)
def test_composite_is_a_weighted_sum(batch: tuple[int, ...]):
    weights, *_ = random_rays(batch, samples=3)
    values = torch.stack(random_rays(batch, samples=3, seed=1), dim=-1)
    expected = sum(weights[..., k, None] * values[..., k, :] for k in range(3))
    torch.testing.assert_close(composite(weights, values), expected)


def test_gradients_are_finite_where_a_volume_is_opaque_or_empty():
    sigma = torch.tensor([0.0, 1e4, 0.0, 1e4], requires_grad=True)
    weights = composite_weights(sigma)
    (weights * torch.arange(4)).sum().backward()
    assert sigma.grad is not None
    assert sigma.grad.isfinite().all()


def test_a_thin_ray_has_the_colour_of_what_little_there_is():
    colour, opacity = torch.tensor([0.2, 0.4, 0.8]), torch.tensor([[0.0], [0.01], [THIN], [THICK], [0.9], [1.0]])
    expected = colour * torch.tensor([[0.0], [1.0], [1.0], [THICK], [0.9], [1.0]])
    torch.testing.assert_close(thickened(colour * opacity, opacity), expected)
    between = thickened(torch.full((9,), 0.1), torch.linspace(THIN, THICK, 9))
    assert (between.diff() < 0).all()  # from divided to not divided


def test_the_curve_of_thin_rays_by_hand():
    """s rises in a straight line from 0 at 0.25 to 1 at 0.75; the colour is divided by o + (1 - o) s."""
    opacity = torch.tensor([0.0, 0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875])
    divisor = torch.tensor([0.001, 0.125, 0.25, 0.53125, 0.75, 0.90625, 1.0, 1.0])
    torch.testing.assert_close(thickened(torch.full((8,), 0.1), opacity), 0.1 / divisor)


def test_static_confidence_is_the_static_share_and_1_of_nothing():
    static, dynamic = torch.tensor([[0.6, 0.0, 0.3, 0.0, 1e-9], [0.2, 0.5, 0.0, 0.0, 1e-9]])
    torch.testing.assert_close(static_share(static, dynamic), torch.tensor([0.75, 0.0, 1.0, 1.0, 1.0]))
    weights = torch.zeros(2, 3, requires_grad=True)
    static_share(weights, weights).sum().backward()
    assert weights.grad is not None
    assert torch.isfinite(weights.grad).all()


def test_a_volume_alone_as_if_it_were_opaque():
    """The mean by weight; a ray of less than a thousandth is left as good as black."""
    colour, opacity = torch.tensor([[0.1], [0.4], [0.0005], [0.0]]), torch.tensor([[0.2], [1.0], [0.0005], [0.0]])
    torch.testing.assert_close(as_if_opaque(colour, opacity), torch.tensor([[0.5], [0.4], [0.5], [0.0]]))

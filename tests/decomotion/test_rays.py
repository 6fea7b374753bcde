"""Where rays are sampled."""

from __future__ import annotations

import pytest
import torch

from decomotion.pseudo_depth import FAR, NEAR
from decomotion.rays import lift, sample_depths

BATCHES = [(), (5,), (2, 3)]


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


@pytest.mark.parametrize("batch", BATCHES)
@pytest.mark.parametrize("samples", [1, 4, 32])
def test_one_stratified_sample_in_each_bin(batch: tuple[int, ...], samples: int):
    depths = sample_depths(torch.zeros(*batch, 2), samples, generator())
    bins = ((depths - NEAR) / (FAR - NEAR) * samples).floor()
    assert depths.shape == (*batch, samples)
    assert (bins == torch.arange(samples)).all()


def test_stratified_samples_fill_their_bins_evenly():
    depths = sample_depths(torch.zeros(4000, 2), 4, generator())
    within = (depths / 0.5) % 1
    # standard error of 16,000 uniform numbers: 0.0023
    assert within.mean() == pytest.approx(0.5, abs=0.01)
    assert within.std() == pytest.approx(12**-0.5, abs=0.01)


@pytest.mark.parametrize("batch", BATCHES)
def test_without_a_generator_the_bins_centres(batch: tuple[int, ...]):
    depths = sample_depths(torch.zeros(*batch, 2), 4)
    torch.testing.assert_close(depths.expand(*batch, 4), torch.tensor([0.25, 0.75, 1.25, 1.75]).expand(*batch, 4))


def test_a_generator_s_seed_decides():
    first, same, other = (sample_depths(torch.zeros(3, 2), 8, generator(seed)) for seed in (1, 1, 2))
    assert torch.equal(first, same)
    assert not torch.equal(first, other)


@pytest.mark.parametrize("batch", BATCHES)
def test_rays_are_orthographic(batch: tuple[int, ...]):
    xy, depths = torch.rand(*batch, 2, generator=generator()), torch.rand(*batch, 6, generator=generator(1))
    points = lift(xy, depths)
    assert points.shape == (*batch, 6, 3)
    assert torch.equal(points[..., :2], xy[..., None, :].expand(*batch, 6, 2))
    assert torch.equal(points[..., 2], depths)

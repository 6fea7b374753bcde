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
def test_one_sample_in_each_bin_where_its_offset_says(batch: tuple[int, ...], samples: int):
    offset = torch.rand(*batch, samples, generator=generator())
    depths = sample_depths(torch.zeros(*batch, 2), samples, offset)
    assert depths.shape == (*batch, samples)
    expected = NEAR + (torch.arange(samples) + offset) * (FAR - NEAR) / samples
    torch.testing.assert_close(depths, expected)


@pytest.mark.parametrize("batch", BATCHES)
def test_without_offsets_the_bins_centres(batch: tuple[int, ...]):
    depths = sample_depths(torch.zeros(*batch, 2), 4)
    torch.testing.assert_close(depths.expand(*batch, 4), torch.tensor([0.25, 0.75, 1.25, 1.75]).expand(*batch, 4))


@pytest.mark.parametrize("batch", BATCHES)
def test_rays_are_orthographic(batch: tuple[int, ...]):
    xy, depths = torch.rand(*batch, 2, generator=generator()), torch.rand(*batch, 6, generator=generator(1))
    points = lift(xy, depths)
    assert points.shape == (*batch, 6, 3)
    assert torch.equal(points[..., :2], xy[..., None, :].expand(*batch, 6, 2))
    assert torch.equal(points[..., 2], depths)

"""A volume's transforms, there and back, and what it holds."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from decomotion.model.config import SurfaceConfig
from decomotion.model.volume import Volume, centred, decentred
from tiny_fit import randomised, tiny_model

FRAMES = 5

both_presets = pytest.mark.parametrize("preset", ["cpu", "paper"])


def random(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def make_volume(preset: str) -> Volume:
    """A dynamic volume in double precision whose parameters are all random."""
    return randomised(tiny_model(preset, frames=FRAMES).dynamic.double(), 0.1)


@both_presets
def test_there_and_back(preset: str):
    volume = make_volume(preset)
    conditioning = volume.condition(random(FRAMES, 8), torch.arange(FRAMES))
    points = 0.7 * random(FRAMES, 40, 3, seed=1) + torch.tensor([0.0, 0.0, 1.0])
    there = volume.to_canonical(points, conditioning)
    assert (there - centred(points)).norm(dim=-1).mean() > 0.05  # the maps do move points
    # the coupling directions' bases are rounded to float32
    torch.testing.assert_close(volume.from_canonical(there, conditioning), points, rtol=0, atol=1e-5)


@both_presets
def test_there_and_back_in_the_precision_of_a_fit(preset: str):
    volume = make_volume(preset).float()
    conditioning = volume.condition(random(FRAMES, 8).float(), torch.arange(FRAMES))
    points = (0.7 * random(FRAMES, 40, 3, seed=1) + torch.tensor([0.0, 0.0, 1.0])).float()
    back = volume.from_canonical(volume.to_canonical(points, conditioning), conditioning)
    # a thousandth of a pixel of a 256-pixel frame is 8e-6
    torch.testing.assert_close(back, points, rtol=0, atol=2e-5)


@both_presets
def test_rows_of_conditioning(preset: str):
    """Conditioning of chosen frames, taken from all frames' or picked row by row: three ways to the same answer."""
    volume, codes = make_volume(preset), random(FRAMES, 8)
    frame = torch.tensor([3, 0, 3, 1])
    points = random(4, 7, 3, seed=1)
    everything = volume.condition(codes, torch.arange(FRAMES))
    expected = volume.to_canonical(points, volume.condition(codes, frame))
    torch.testing.assert_close(volume.to_canonical(points, everything.take(frame)), expected)
    torch.testing.assert_close(volume.to_canonical(points, everything, frame), expected)
    back = volume.from_canonical(expected, everything, frame)
    torch.testing.assert_close(back, volume.from_canonical(expected, everything.take(frame)))


@both_presets
@pytest.mark.parametrize("batch", [(), (6,), (2, 3)])
def test_matter_is_in_range(preset: str, batch: tuple[int, ...]):
    matter = make_volume(preset).matter(random(*batch, 3))
    assert matter.density.shape == matter.confidence.shape == batch
    assert matter.colour.shape == (*batch, 3)
    assert (matter.density >= 0).all()
    for value in (matter.colour, matter.confidence):
        assert ((value >= 0) & (value <= 1)).all()


def test_a_sheet_of_density_to_start_with():
    volume = make_volume("cpu")
    volume.surface = SurfaceConfig(depth=1.3, thickness=0.2, peak=4.0)
    z = torch.tensor([0.3, 0.5, 0.1, 0.2, 1.0, -1.0])  # canonical: 0 is the middle, depth 1
    torch.testing.assert_close(volume.surface_prior(z), torch.tensor([4.0, 0.0, 0.0, 3.0, -4.0, -4.0]))


def test_without_a_sheet_all_is_thin():
    volume = make_volume("paper")
    assert volume.surface is None
    assert volume.surface_prior(torch.tensor([-1.0, 0.0, 1.0])).tolist() == [-1] * 3


@pytest.mark.parametrize("batch", [(), (6,), (2, 3)])
def test_the_middle_of_the_local_volume_is_the_origin(batch: tuple[int, ...]):
    points = random(*batch, 3)
    assert centred(torch.tensor([0.0, 0.0, 1.0])).tolist() == [0, 0, 0]
    torch.testing.assert_close(decentred(centred(points)), points)

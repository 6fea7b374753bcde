"""Fields: filters and contraction against their formulas."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from decomotion.model.config import GaborFieldConfig, GridFieldConfig
from decomotion.model.field import GaborField, GaborFilter, GridField, build_field, contract
from tiny_fit import randomised

GABOR = GaborFieldConfig(kind="gabor", width=6, layers=3, input_scale=8.0, alpha=3.0)
GRID = GridFieldConfig(kind="grid", width=6, channels=3, image_cells=(4, 8), depth_cells=4)
EXTENT = torch.tensor([1.0, 0.6, 1.2])


def random(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("config", [GABOR, GRID], ids=["gabor", "grid"])
@pytest.mark.parametrize("points", [0, 1, 5])
def test_a_vector_for_each_point(config: GaborFieldConfig | GridFieldConfig, points: int):
    field = build_field(config, EXTENT)
    assert field(random(points, 3)).shape == (points, config.width)


@pytest.mark.parametrize("config", [GABOR, GRID], ids=["gabor", "grid"])
def test_all_parameters_have_a_gradient(config: GaborFieldConfig | GridFieldConfig):
    field = randomised(build_field(config, EXTENT))
    field(0.3 * random(200, 3)).square().sum().backward()
    assert all(parameter.grad is not None and parameter.grad.any() for parameter in field.parameters())


def test_gabor_filter_is_its_formula():
    torch.manual_seed(0)
    gabor = GaborFilter(5, 4.0, 1.5).double()
    points = random(7, 3).double()
    values = gabor(points)
    for point in range(7):
        for channel in range(5):
            x, omega, phi = points[point], gabor.linear.weight[channel], gabor.linear.bias[channel]
            distance = (x - gabor.centre[channel]).norm()
            expected = torch.sin(omega @ x + phi) * torch.exp(-gabor.gamma[channel] / 2 * distance**2)
            assert values[point, channel].item() == pytest.approx(expected.item(), abs=1e-12)


def test_gabor_field_is_a_multiplicative_network():
    torch.manual_seed(0)
    field = GaborField(GABOR, EXTENT).double()
    points = random(7, 3).double()
    filters = [gabor(contract(points)) for gabor in field.filters]
    hidden = filters[0]
    for layer in range(3):
        hidden = filters[layer + 1] * field.linears[layer](hidden)
    torch.testing.assert_close(field(points), hidden)


@pytest.mark.parametrize("batch", [(), (4,), (2, 3)])
def test_contraction_keeps_the_unit_ball_and_brings_all_else_within_two(batch: tuple[int, ...]):
    points = 3 * random(*batch, 3)
    inside = contract(points)
    near = (points.norm(dim=-1) <= 1)[..., None]
    torch.testing.assert_close(torch.where(near, inside, 0), torch.where(near, points, 0))
    assert (inside.norm(dim=-1) < 2).all()
    torch.testing.assert_close(torch.linalg.cross(inside, points), torch.zeros_like(points), rtol=0, atol=1e-5)


def test_contraction_by_hand():
    points = torch.tensor([[0.0, 0.0, 0.0], [0.6, 0.8, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, -4.0]])
    expected = torch.tensor([[0.0, 0.0, 0.0], [0.6, 0.8, 0.0], [0.0, 1.5, 0.0], [0.0, 0.0, -1.75]])
    torch.testing.assert_close(contract(points), expected)


def test_contraction_is_smooth_at_the_origin():
    points = torch.zeros(1, 3, requires_grad=True)
    contract(points).sum().backward()
    assert points.grad is not None
    torch.testing.assert_close(points.grad, torch.ones(1, 3))


def test_grid_field_is_constant_beyond_its_extent():
    torch.manual_seed(0)
    field = GridField(GRID, EXTENT)
    border = EXTENT * torch.tensor([[1.0, 1.0, 1.0], [1.0, -1.0, 1.0], [-1.0, 1.0, -1.0]])
    torch.testing.assert_close(field(5 * border), field(border))


def test_grid_field_tells_all_three_coordinates_apart():
    torch.manual_seed(0)
    field = randomised(GridField(GRID, EXTENT))
    middle = field(torch.zeros(1, 3))
    for axis in torch.eye(3):
        assert (field(0.3 * axis[None]) - middle).abs().max() > 1e-3


def test_gabor_filter_does_not_blow_up_far_away():
    """Positions are contracted first; a filter alone, at the ball's edge, stays within [-1, 1] up to rounding."""
    torch.manual_seed(0)
    gabor = GaborFilter(64, 256.0, 0.75)
    assert gabor(contract(1e6 * random(100, 3))).abs().max() <= 1 + 1e-5


def test_gabor_filters_begin_as_configured():
    """Of four filters each has a share: gamma is alpha / 4 on average, the frequencies input_scale / 2 sqrt(gamma)."""
    torch.manual_seed(0)
    field = GaborField(GaborFieldConfig(kind="gabor", width=4000, layers=3, input_scale=8.0, alpha=3.0), EXTENT)
    assert len(field.filters) == 4
    assert len(field.linears) == 3
    for gabor in field.filters:
        assert gabor.gamma.mean().item() == pytest.approx(0.75, rel=0.1)
        assert gabor.gamma.var().item() == pytest.approx(0.75, rel=0.2)  # Gamma's variance is its mean
        uniform = gabor.linear.weight / gabor.gamma.sqrt()[:, None]
        assert uniform.abs().max().item() == pytest.approx(8.0 / 2 / 3**0.5, rel=0.01)
        assert uniform.mean().item() == pytest.approx(0, abs=0.1)
        assert gabor.linear.bias.abs().max().item() == pytest.approx(math.pi, rel=0.01)
        assert (gabor.centre.min().item(), gabor.centre.max().item()) == pytest.approx((-1, 1), abs=0.01)
    for linear in field.linears:
        assert linear.weight.abs().max().item() == pytest.approx(4000**-0.5, rel=0.01)


@pytest.mark.parametrize("upright", [False, True])
def test_planes_of_a_grid_field(upright: bool):
    """Two normalised units, the longer side of the image, have 4 and 8 cells; z has as many for each of its units."""
    torch.manual_seed(0)
    extent = EXTENT[[1, 0, 2]] if upright else EXTENT
    field = GridField(GridFieldConfig(kind="grid", width=6, channels=30, image_cells=(4, 8), depth_cells=5), extent)
    # along x cells = 1.0 * cells + 1 values, along y 0.6 * cells, rounded up
    sizes = [tuple(plane.shape[-2:]) for plane in field.image_planes]
    assert [size[::-1] if upright else size for size in sizes] == [(4, 5), (6, 9)]
    assert tuple(field.depth_planes.shape) == (2, 30, 7, 6)
    assert field.network[0].in_features == 30 * 4 + 3
    for values in (*field.image_planes, field.depth_planes):
        assert values.std().item() == pytest.approx(0.1, rel=0.15)
        assert values.mean().item() == pytest.approx(0, abs=0.02)


def test_a_grid_field_reads_its_planes_between_their_corners():
    """Ramps over the planes come back as the coordinates; beyond the extent they stay as on its border."""
    field = GridField(GridFieldConfig(kind="grid", width=6, channels=1, image_cells=(4,), depth_cells=4), EXTENT)
    with torch.no_grad():
        height, width = field.image_planes[0].shape[-2:]
        field.image_planes[0][0, 0] = torch.linspace(-0.6, 0.6, height)[:, None].expand(-1, width)  # y
        deep, across = field.depth_planes.shape[-2:]
        field.depth_planes[0, 0] = torch.linspace(-1, 1, across).expand(deep, -1)  # x
        field.depth_planes[1, 0] = torch.linspace(-1.2, 1.2, deep)[:, None].expand(-1, across)  # z
    field.network = torch.nn.Identity()
    points = torch.tensor([[0.3, -0.2, 0.9], [-0.71, 0.55, -1.1], [3.0, -0.9, 1.3]])
    x, y, z = points[:, 0].clamp(-1, 1), points[:, 1].clamp(-0.6, 0.6), points[:, 2].clamp(-1.2, 1.2)
    expected = torch.stack([y, x, z, x, y / 0.6, z / 1.2], dim=-1)  # the planes' values, then the place in the box
    torch.testing.assert_close(field(points), expected, atol=1e-5, rtol=0)

"""Fields: networks from a canonical position to a vector, of which the volume's quantities are linear functions."""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from decomotion.model.config import GaborFieldConfig, GridFieldConfig
from decomotion.model.coupling import grid_size
from decomotion.model.precision import HiddenLinear


def build_field(config: GaborFieldConfig | GridFieldConfig, extent: Float[Tensor, "3"]) -> nn.Module:
    """The field that `config` describes: [point, 3] -> [point, field.width].

    Args:
        config: the field's leaf of the configuration.
        extent: half the size of the canonical box in which points are expected, along x, y and z.
    """
    return GaborField(config, extent) if config.kind == "gabor" else GridField(config, extent)


class GaborField(nn.Module):
    """Multiplicative filter network with Gabor filters (Fathony et al. 2020), without its last linear layer.

    h_0 = g_0(x), h_l = g_l(x) * (W_l h_{l-1} + b_l), with filters
    g(x) = sin(omega x + phi) exp(-gamma / 2 ||x - mu||^2). Positions are contracted into the ball of radius 2
    first, as in OmniMotion, so that nothing lies outside.
    """

    def __init__(self, config: GaborFieldConfig, extent: Float[Tensor, "3"]) -> None:
        super().__init__()
        self.width = config.width
        filters = config.layers + 1
        self.filters = nn.ModuleList(
            GaborFilter(config.width, config.input_scale / math.sqrt(filters), config.alpha / filters)
            for _ in range(filters)
        )
        self.linears = nn.ModuleList(HiddenLinear(config.width, config.width) for _ in range(config.layers))
        for linear in self.linears:
            assert isinstance(linear, nn.Linear)
            bound = 1 / math.sqrt(config.width)
            nn.init.uniform_(linear.weight, -bound, bound)
        del extent  # contraction makes it needless

    def forward(self, points: Float[Tensor, "point 3"]) -> Float[Tensor, "point width"]:
        """The last hidden layer at canonical positions."""
        inside = contract(points)
        hidden = self.filters[0](inside)
        for gabor, linear in zip(list(self.filters)[1:], self.linears, strict=True):
            hidden = gabor(inside) * linear(hidden)
        return hidden


def contract(points: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Identity inside the unit ball; (2 - 1 / |x|) x / |x| outside, which fills the ball of radius 2."""
    norm = points.norm(dim=-1, keepdim=True).clamp_min(1.0)
    return points * ((2 - 1 / norm) / norm)


class GaborFilter(nn.Module):
    """sin(omega x + phi) exp(-gamma / 2 ||x - mu||^2)."""

    def __init__(self, width: int, weight_scale: float, alpha: float) -> None:
        super().__init__()
        self.linear = nn.Linear(3, width)
        self.centre = nn.Parameter(2 * torch.rand(width, 3) - 1)
        self.gamma = nn.Parameter(torch.distributions.Gamma(alpha, 1.0).sample((width,)))
        with torch.no_grad():
            self.linear.weight *= weight_scale * self.gamma.sqrt()[:, None]
            nn.init.uniform_(self.linear.bias, -math.pi, math.pi)

    def forward(self, points: Float[Tensor, "point 3"]) -> Float[Tensor, "point width"]:
        """The filter's value for each of its channels; the squared distance is one matrix product."""
        squares = (points * points).sum(-1, keepdim=True)
        # -gamma/2 |x - mu|^2 = x . (gamma mu) - gamma/2 |x|^2 - gamma/2 |mu|^2
        weight = torch.cat([self.gamma[:, None] * self.centre, -0.5 * self.gamma[:, None]], dim=-1)
        bias = -0.5 * self.gamma * (self.centre * self.centre).sum(-1)
        exponent = F.linear(torch.cat([points, squares], dim=-1), weight, bias)
        return torch.sin(self.linear(points)) * torch.exp(exponent)


class GridField(nn.Module):
    """Learned planes of growing resolution, read bilinearly, through a small MLP.

    Most detail of a quasi-3D canonical volume lies across the image: the x-y planes are fine; the x-z and y-z
    planes, which say what happens along the rays, are coarse.
    """

    reach: Tensor

    def __init__(self, config: GridFieldConfig, extent: Float[Tensor, "3"]) -> None:
        super().__init__()
        self.width = config.width
        self.register_buffer("reach", extent.clone())
        self.image_planes = nn.ParameterList(
            0.1 * torch.randn(1, config.channels, *grid_size(extent[:2], cells)) for cells in config.image_cells
        )
        depth, across = grid_size(torch.stack([extent[:2].max(), extent[2]]), config.depth_cells)
        self.depth_planes = nn.Parameter(0.1 * torch.randn(2, config.channels, depth, across))
        self.network = nn.Sequential(
            nn.Linear(config.channels * (len(config.image_cells) + 2) + 3, config.width),
            nn.ReLU(),
            nn.Linear(config.width, config.width),
            nn.ReLU(),
        )

    def forward(self, points: Float[Tensor, "point 3"]) -> Float[Tensor, "point width"]:
        """The MLP's last hidden layer at canonical positions."""
        inside = points / self.reach
        x, y, z = inside.unbind(-1)
        across = torch.stack([x, y], dim=-1)[None, :, None]
        along = torch.stack([torch.stack([x, z], dim=-1), torch.stack([y, z], dim=-1)])[:, :, None]
        values = [_read(plane, across)[0] for plane in self.image_planes]
        values += list(_read(self.depth_planes, along).unbind(0))
        return self.network(torch.cat([*values, inside.clamp(-1, 1).T]).T)


def _read(
    planes: Float[Tensor, "plane channel height width"], where: Float[Tensor, "plane point 1 2"]
) -> Float[Tensor, "plane channel point"]:
    return F.grid_sample(planes, where, mode="bilinear", padding_mode="border", align_corners=True)[..., 0]

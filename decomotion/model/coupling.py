"""Invertible layers: one coordinate is scaled and shifted, given the two others and the frame (Real-NVP).

A layer moves points along one unit vector `direction` and leaves the two coordinates in the plane across it alone.
What it moves by is therefore known on both sides of the layer, and the inverse is closed-form (Dinh et al. 2017):

    c' = c exp(s(a, b, frame)) + m(a, b, frame)        c = (c' - m(a, b, frame)) exp(-s(a, b, frame))

With a direction along an axis this is OmniMotion's layer. A direction that is oblique to the depth axis sees a
surface z = const through a one-to-one projection, so a single layer can shift each point of the surface by an
amount of its own; an axis-aligned layer can only shift whole lines of it.

What s and m are comes from a conditioner: `condition(code)` computes what it needs of each frame, once per frame;
calling it with positions in the plane gives s and m, with `frame` picking each batch row's frame (None: row by row).
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor, nn

from decomotion.model.config import GridConditionerConfig, MlpConditionerConfig
from decomotion.model.precision import HiddenLinear

LOG_SCALE_LIMIT = 8.0
"""Bound of an MLP's log-scale, as in OmniMotion."""


def build_conditioner(
    config: MlpConditionerConfig | GridConditionerConfig, code_size: int, half: Float[Tensor, "2"]
) -> MlpConditioner | GridConditioner:
    """The conditioner that `config` describes, for points within +-`half` in the plane across the direction."""
    return MlpConditioner(config, code_size) if config.kind == "mlp" else GridConditioner(config, code_size, half)


class CouplingLayer(nn.Module):
    """One invertible layer; see the module's docstring for its equation."""

    basis: Tensor

    def __init__(
        self,
        direction: tuple[float, float, float],
        conditioner: MlpConditionerConfig | GridConditionerConfig,
        code_size: int,
        extent: Float[Tensor, "3"],
    ) -> None:
        super().__init__()
        basis = _basis_across(direction)
        self.register_buffer("basis", basis, persistent=False)
        self.conditioner = build_conditioner(conditioner, code_size, basis[:2].abs() @ extent)

    def condition(self, code: Float[Tensor, "frame code"]) -> Float[Tensor, "frame ..."]:
        """Per-frame conditioning of this layer."""
        return self.conditioner.condition(code)

    def to_canonical(
        self,
        points: Float[Tensor, "batch point 3"],
        conditioning: Float[Tensor, "frame ..."],
        frame: Int[Tensor, " batch"] | None = None,
    ) -> Float[Tensor, "batch point 3"]:
        """c' = c exp(s) + m along the layer's direction."""
        turned = points @ self.basis.T
        along = turned[..., 2]
        log_scale, shift = self.conditioner(turned[..., :2], conditioning, frame)
        moved = along * torch.exp(log_scale) + shift
        return points + (moved - along)[..., None] * self.basis[2]

    def from_canonical(
        self,
        points: Float[Tensor, "batch point 3"],
        conditioning: Float[Tensor, "frame ..."],
        frame: Int[Tensor, " batch"] | None = None,
    ) -> Float[Tensor, "batch point 3"]:
        """c = (c' - m) exp(-s): the exact inverse of `to_canonical`."""
        turned = points @ self.basis.T
        along = turned[..., 2]
        log_scale, shift = self.conditioner(turned[..., :2], conditioning, frame)
        moved = (along - shift) * torch.exp(-log_scale)
        return points + (moved - along)[..., None] * self.basis[2]


def _basis_across(direction: tuple[float, float, float]) -> Float[Tensor, "3 3"]:
    """Orthonormal rows: two that span the plane across `direction`, then `direction` itself.

    The plane's first two rows are the image's x and y axes made orthogonal to the direction where that is possible.
    """
    along = torch.tensor(direction, dtype=torch.float64)
    along = along / along.norm()
    candidates = torch.eye(3, dtype=torch.float64)
    across = candidates - (candidates @ along)[:, None] * along
    order = sorted(range(3), key=lambda axis: (-round(float(across[axis].norm()), 6), axis))
    first = across[min(order[:2])] / across[min(order[:2])].norm()
    second = across[max(order[:2])] - (across[max(order[:2])] @ first) * first
    return torch.stack([first, second / second.norm(), along]).float()


class MlpConditioner(nn.Module):
    """OmniMotion's conditioner: positional encoding of the plane, joined by the frame's code, through an MLP.

    The first layer is split in two, so that its part for the frame's code is computed once per frame.
    """

    frequencies: Tensor

    def __init__(self, config: MlpConditionerConfig, code_size: int) -> None:
        super().__init__()
        frequencies = math.pi * 2.0 ** torch.arange(config.frequencies)
        self.register_buffer("frequencies", frequencies, persistent=False)
        self.encode = nn.Linear(2 + 4 * config.frequencies, config.encoding)
        self.project_code = nn.Sequential(
            nn.Linear(code_size, code_size), nn.LeakyReLU(), nn.Linear(code_size, code_size)
        )
        self.from_code = nn.Linear(code_size, config.hidden)
        self.from_plane = HiddenLinear(config.encoding, config.hidden, bias=False)
        self.hidden = nn.ModuleList(HiddenLinear(config.hidden, config.hidden) for _ in range(config.layers - 1))
        self.output = nn.Linear(config.hidden, 2)
        nn.init.normal_(self.output.weight, std=1e-3)  # the layer starts as the identity, nearly
        nn.init.zeros_(self.output.bias)

    def condition(self, code: Float[Tensor, "frame code"]) -> Float[Tensor, "frame hidden"]:
        """The frame's part of the first hidden layer."""
        return self.from_code(self.project_code(code))

    def forward(
        self,
        plane: Float[Tensor, "batch point 2"],
        conditioning: Float[Tensor, "frame hidden"],
        frame: Int[Tensor, " batch"] | None,
    ) -> tuple[Float[Tensor, "batch point"], Float[Tensor, "batch point"]]:
        """Log-scale and shift, the former clamped to +-8 as in OmniMotion."""
        rows = conditioning if frame is None else conditioning.index_select(0, frame)
        angles = (plane[..., None] * self.frequencies).flatten(-2)
        encoded = F.leaky_relu(self.encode(torch.cat([plane, torch.sin(angles), torch.cos(angles)], dim=-1)))
        position = self.from_plane(encoded)
        hidden = F.leaky_relu(position + rows[:, None].to(position.dtype))
        for layer in self.hidden:
            hidden = F.leaky_relu(layer(hidden))
        log_scale, shift = self.output(hidden.to(plane.dtype)).unbind(-1)
        return log_scale.clamp(-LOG_SCALE_LIMIT, LOG_SCALE_LIMIT), shift


class GridConditioner(nn.Module):
    """Log-scale and shift read by bilinear interpolation from one small grid per frame.

    The frames' grids are mixtures of a few learned ones: `grid_frame = sum_r (W code_frame)_r basis_r`, a sum over
    levels of growing resolution. A look-up costs a hundredth of the MLP's arithmetic and its gradient is local.

    No level is steeper than `config.slope`: chained layers multiply their slopes, and a chain that can amplify without
    bound runs away. Values are therefore kept within half of what the slope allows between neighbouring cells.
    """

    reach: Tensor

    def __init__(self, config: GridConditionerConfig, code_size: int, half: Float[Tensor, "2"]) -> None:
        super().__init__()
        self.register_buffer("reach", half, persistent=False)
        self.mixing = nn.ModuleList(nn.Linear(code_size, config.rank, bias=False) for _ in config.cells)
        self.basis = nn.ParameterList(torch.zeros(config.rank, 2, *grid_size(half, cells)) for cells in config.cells)
        self.bounds = [config.slope / 2 * spacing(half, basis) for basis in self.basis]
        for mix in self.mixing:
            assert isinstance(mix, nn.Linear)
            # a step of Adam moves each of `rank` grids by the learning rate: together they should move as far as one
            nn.init.normal_(mix.weight, std=1 / (math.sqrt(code_size) * config.rank))

    def condition(self, code: Float[Tensor, "frame code"]) -> Float[Tensor, "frame 2 height width"]:
        """The frames' grids at the finest resolution."""
        finest = self.basis[-1].shape[-2:]
        grids = code.new_zeros(())
        for mix, basis, bound in zip(self.mixing, self.basis, self.bounds, strict=True):
            mixed = (mix(code) @ basis.flatten(1)).unflatten(1, basis.shape[1:])
            level = bound * torch.tanh(mixed / bound)
            if level.shape[-2:] != finest:
                level = enlarged(level, finest)
            grids = grids + level
        return grids

    def forward(
        self,
        plane: Float[Tensor, "batch point 2"],
        conditioning: Float[Tensor, "frame 2 height width"],
        frame: Int[Tensor, " batch"] | None,
    ) -> tuple[Float[Tensor, "batch point"], Float[Tensor, "batch point"]]:
        """Log-scale and shift; constant beyond the grid's extent."""
        where = plane / self.reach
        if frame is None:
            values = F.grid_sample(
                conditioning, where[:, :, None], mode="bilinear", padding_mode="border", align_corners=True
            )[..., 0]
            return values[:, 0], values[:, 1]
        return self._look_up_each(where, conditioning, frame)

    def _look_up_each(
        self,
        where: Float[Tensor, "batch point 2"],
        grids: Float[Tensor, "frame 2 height width"],
        frame: Int[Tensor, " batch"],
    ) -> tuple[Float[Tensor, "batch point"], Float[Tensor, "batch point"]]:
        """As `forward` with a frame of its own for every row: all grids stacked into one tall image."""
        count, _, height, width = grids.shape
        atlas = grids.permute(1, 0, 2, 3).reshape(1, 2, count * height, width)
        inside = where.clamp(-1, 1)
        row = (inside[..., 1] + 1) * ((height - 1) / 2) + (frame * height)[:, None].to(where.dtype)
        down = row * (2 / (count * height - 1)) - 1
        values = F.grid_sample(
            atlas,
            torch.stack([inside[..., 0], down], dim=-1)[None],
            mode="bilinear",
            padding_mode="border",
            align_corners=True,
        )[0]
        return values[0], values[1]


def enlarged(grids: Float[Tensor, "*rest h w"], size: tuple[int, ...]) -> Float[Tensor, "*rest height width"]:
    """Bilinear interpolation to `size`, corners on corners: as two products, a fraction of `F.interpolate`'s time."""
    rows, columns = (
        F.interpolate(
            torch.eye(before, dtype=grids.dtype, device=grids.device)[None], after, mode="linear", align_corners=True
        )[0]
        for before, after in zip(grids.shape[-2:], size, strict=True)
    )
    return rows.T @ grids @ columns


def spacing(half: Float[Tensor, "2"], grid: Float[Tensor, "*rest height width"]) -> float:
    """Length of the shorter side of a grid's cells, the grid covering +-`half`."""
    height, width = grid.shape[-2:]
    return min(2 * float(half[0]) / (width - 1), 2 * float(half[1]) / (height - 1))


def grid_size(half: Float[Tensor, "2"], cells: int) -> tuple[int, int]:
    """Height and width of a grid over +-`half` with `cells` cells to two normalised units, the image's longer side."""
    width, height = (int(torch.ceil(side * cells).item()) + 1 for side in half)
    return height, width

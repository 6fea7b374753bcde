"""A fitted model, frozen: the same maps and fields as `decomotion.model`, in the form that answers fastest.

All that depends on the frame alone is computed here, once, and becomes a constant: affine maps from pixels to the first
coupling layer's own axes, and each layer's grid for each frame. Points are columns, [3, point], and each has its frame.
Between layers they stay in the layers' axes: one product turns them from one layer's to the next one's.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple, cast

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor, nn

from decomo_export.lookup import CellGrid
from decomotion.geometry import ImagePlane
from decomotion.model.coupling import CouplingLayer, GridConditioner
from decomotion.model.field import GridField
from decomotion.model.volume import Conditioning, Volume


class Matter(NamedTuple):
    """What a volume holds at canonical positions, as `decomotion.model.volume.Matter`; colours are columns."""

    density: Float[Tensor, "*batch"]
    colour: Float[Tensor, "3 *batch"]
    confidence: Float[Tensor, "*batch"]


class FrozenVolume(nn.Module):
    """One volume: from pixels and pseudo-depth to canonical space and back, and what is found there.

    Args:
        volume: the trained volume.
        conditioning: of all frames of the clip.
        plane: the clip's raster.
    """

    to_first: Tensor
    from_first: Tensor

    def __init__(self, volume: Volume, conditioning: Conditioning, plane: ImagePlane) -> None:
        super().__init__()
        layers = cast(list[CouplingLayer], list(volume.couplings))
        bases = [layer.basis.double() for layer in layers] or [torch.eye(3, dtype=torch.float64)]
        self._affine(conditioning.affine.double(), bases[0], plane)
        turns = [*(after @ before.T for before, after in pairwise(bases)), bases[-1].T]
        for index, turn in enumerate(turns):
            self.register_buffer(f"turn_{index}", turn.float(), persistent=False)
        self.couplings = nn.ModuleList(
            _freeze_coupling(layer, rows) for layer, rows in zip(layers, conditioning.couplings, strict=True)
        )
        self.field = FrozenGridField(volume.field) if isinstance(volume.field, GridField) else ByRows(volume.field)
        self.volume = volume

    def _affine(self, maps: Tensor, basis: Tensor, plane: ImagePlane) -> None:
        """`to_first` [frame, 12]: (x, y in pixels, pseudo-depth) to the first layer's axes; `from_first`: back."""
        scale = plane.pixels_per_unit
        size = maps.new_tensor([1 / scale, 1 / scale, 1.0])
        origin = maps.new_tensor([-plane.centre[0] / scale, -plane.centre[1] / scale, -1.0])
        matrix, offset, inverse, inverse_offset = maps.split([3, 1, 3, 1], dim=-1)
        forward = torch.cat([basis @ matrix * size, basis @ (matrix @ origin[:, None] + offset)], dim=-1)
        backward = torch.cat([inverse @ basis.T, inverse_offset - origin[:, None]], dim=-1) / size[:, None]
        self.register_buffer("to_first", forward.flatten(1).float(), persistent=False)
        self.register_buffer("from_first", backward[:, :2].flatten(1).float(), persistent=False)

    def to_canonical(
        self, xy: Float[Tensor, "2 point"], depth: Float[Tensor, " point"], frame: Int[Tensor, " point"]
    ) -> Float[Tensor, "3 point"]:
        """Canonical positions of points at pixels `xy` and pseudo-depth `depth` of their frames."""
        maps = self.to_first.index_select(0, frame).T.unflatten(0, (3, 4))
        turned = maps[:, 0] * xy[0] + maps[:, 1] * xy[1] + maps[:, 2] * depth + maps[:, 3]
        for index, layer in enumerate(self.couplings):
            log_scale, shift = layer(turned[:2], frame)
            moved = turned[2:] * torch.exp(log_scale) + shift
            turned = self.get_buffer(f"turn_{index}") @ torch.cat([turned[:2], moved])
        return turned

    def to_pixels(self, canonical: Float[Tensor, "3 point"], frame: Int[Tensor, " point"]) -> Float[Tensor, "2 point"]:
        """Pixels of the points' frames at which canonical positions are: the inverse of `to_canonical`."""
        turned = canonical
        for index in reversed(range(len(self.couplings))):
            turned = self.get_buffer(f"turn_{index}").T @ turned
            log_scale, shift = self.couplings[index](turned[:2], frame)
            turned = torch.cat([turned[:2], (turned[2:] - shift) * torch.exp(-log_scale)])
        maps = self.from_first.index_select(0, frame).T.unflatten(0, (2, 4))
        return maps[:, 0] * turned[0] + maps[:, 1] * turned[1] + maps[:, 2] * turned[2] + maps[:, 3]

    def matter(self, canonical: Float[Tensor, "3 point"]) -> Matter:
        """What is found at canonical positions."""
        head = self.volume.head
        raw = head.weight @ self.field(canonical) + head.bias[:, None]
        density = raw[3] + self.volume.surface_prior(canonical[2])
        return Matter(F.softplus(density), torch.sigmoid(raw[:3]), torch.sigmoid(raw[4]))


def _freeze_coupling(layer: CouplingLayer, rows: Tensor) -> nn.Module:
    conditioner = layer.conditioner
    if isinstance(conditioner, GridConditioner):
        return FrozenGrid(rows, conditioner.reach)
    return FrozenNetwork(conditioner, rows)


class FrozenGrid(nn.Module):
    """A coupling layer's log-scale and shift from the grids of all frames."""

    def __init__(self, rows: Float[Tensor, "frame 2 height width"], reach: Float[Tensor, "2"]) -> None:
        super().__init__()
        self.grid = CellGrid(rows, reach)

    def forward(
        self, plane: Float[Tensor, "2 point"], frame: Int[Tensor, " point"]
    ) -> tuple[Float[Tensor, "1 point"], Float[Tensor, "1 point"]]:
        """Log-scale and shift at places in the layer's plane."""
        log_scale, shift = self.grid(plane, frame).chunk(2)
        return log_scale, shift


class FrozenNetwork(nn.Module):
    """A coupling layer's log-scale and shift from its network, the codes' part of all frames computed."""

    rows: Tensor

    def __init__(self, conditioner: nn.Module, rows: Float[Tensor, "frame hidden"]) -> None:
        super().__init__()
        self.conditioner = conditioner
        self.register_buffer("rows", rows, persistent=False)

    def forward(
        self, plane: Float[Tensor, "2 point"], frame: Int[Tensor, " point"]
    ) -> tuple[Float[Tensor, "1 point"], Float[Tensor, "1 point"]]:
        """Log-scale and shift at places in the layer's plane."""
        log_scale, shift = self.conditioner(plane.T[:, None], self.rows, frame)
        return log_scale.T, shift.T


class FrozenGridField(nn.Module):
    """`GridField` with its planes in the form of look-ups."""

    reach: Tensor

    def __init__(self, field: GridField) -> None:
        super().__init__()
        one = torch.ones(2)
        self.image_planes = nn.ModuleList(CellGrid(plane.detach(), one) for plane in field.image_planes)
        self.depth_planes = nn.ModuleList(CellGrid(plane[None].detach(), one) for plane in field.depth_planes)
        self.network = field.network
        self.register_buffer("reach", field.reach[:, None].clone(), persistent=False)

    def forward(self, points: Float[Tensor, "3 point"]) -> Float[Tensor, "width point"]:
        """The MLP's last hidden layer at canonical positions."""
        inside = points / self.reach
        values = [plane(inside[:2]) for plane in self.image_planes]
        values += [plane(inside[axis :: 2 - axis]) for axis, plane in enumerate(self.depth_planes)]
        hidden = torch.cat([*values, inside.clamp(-1, 1)])
        for linear in cast(list[nn.Linear], list(self.network)[::2]):
            hidden = torch.relu(linear.weight @ hidden + linear.bias[:, None])
        return hidden


class ByRows(nn.Module):
    """A field whose points are rows, asked with columns."""

    def __init__(self, field: nn.Module) -> None:
        super().__init__()
        self.field = field

    def forward(self, points: Float[Tensor, "3 point"]) -> Float[Tensor, "width point"]:
        """The field's last hidden layer at canonical positions."""
        return self.field(points.T).T

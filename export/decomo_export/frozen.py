"""A fitted model, frozen: the same maps and fields as `decomotion.model`, in the form that answers fastest.

All that depends on the frame alone is computed here, once, and becomes a constant: affine maps from pixels to the first
coupling layer's own coordinates, and each layer's grid for each frame. Points are columns, [3, point], and each has its
frame. Between layers they stay in the layers' coordinates, the plane in samples of the layer's grid: one product leads
from one layer's to the next one's.
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


class MatterColumns(NamedTuple):
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
        frozen = [_freeze_coupling(layer, rows) for layer, rows in zip(layers, conditioning.couplings, strict=True)]
        self.couplings = nn.ModuleList(frozen)
        axes = [_axes(layer, coupling) for layer, coupling in zip(layers, frozen, strict=True)]
        canonical = torch.eye(4, dtype=torch.float64)
        self._affine(conditioning.affine.double(), axes[0] if axes else canonical, plane)
        for index, (before, after) in enumerate(pairwise([*axes, canonical] if axes else [])):
            forward = after @ torch.linalg.inv(before)
            for name, matrix in (("turn", forward), ("back", torch.linalg.inv(forward))):
                self.register_buffer(f"{name}_{index}", matrix[:3, :3].float())
                self.register_buffer(f"{name}_offset_{index}", matrix[:3, 3:].float())
        self.field = FrozenGridField(volume.field) if isinstance(volume.field, GridField) else ByRows(volume.field)
        self.volume = volume

    def _affine(self, maps: Tensor, axes: Float[Tensor, "4 4"], plane: ImagePlane) -> None:
        """`to_first` [frame, 12]: (x, y in pixels, pseudo-depth) to the first layer's coordinates; `from_first`: back.

        Column by column: what x, y and depth are multiplied by, then what is added.
        """
        forward, inverse = from_pixels(maps, plane)
        to_first, from_first = axes @ forward, inverse @ torch.linalg.inv(axes)
        self.register_buffer("to_first", to_first[:, :3].mT.flatten(1).float())
        self.register_buffer("from_first", from_first[:, :2].mT.flatten(1).float())

    def to_canonical(
        self, xy: Float[Tensor, "2 point"], depth: Float[Tensor, "_ sample"], frame: Int[Tensor, " point"]
    ) -> Float[Tensor, "3 point_sample"]:
        """Canonical positions of points at pixels `xy` of their frames, at pseudo-depths of their own, or of all."""
        x, y = xy.split(1)
        by_x, by_y, by_depth, added = self.to_first.index_select(0, frame).T.split(3)
        nearest = by_x * x + by_y * y + added
        turned = (by_depth[:, :, None] * depth + nearest[:, :, None]).flatten(1)
        frames = frame[:, None].expand(-1, depth.shape[1]).flatten()
        for index, layer in enumerate(self.couplings):
            place, along = turned.split([2, 1])
            log_scale, shift = layer(place, frames)
            moved = torch.cat([place, along * torch.exp(log_scale) + shift])
            turned = torch.addmm(self.get_buffer(f"turn_offset_{index}"), self.get_buffer(f"turn_{index}"), moved)
        return turned

    def to_pixels(self, canonical: Float[Tensor, "3 point"], frame: Int[Tensor, " point"]) -> Float[Tensor, "2 point"]:
        """Pixels of the points' frames at which canonical positions are: the inverse of `to_canonical`."""
        turned = canonical
        for index in reversed(range(len(self.couplings))):
            moved = torch.addmm(self.get_buffer(f"back_offset_{index}"), self.get_buffer(f"back_{index}"), turned)
            place, along = moved.split([2, 1])
            log_scale, shift = self.couplings[index](place, frame)
            turned = torch.cat([place, (along - shift) / torch.exp(log_scale)])
        x, y, depth = turned.split(1)
        by_x, by_y, by_depth, added = self.from_first.index_select(0, frame).T.split(2)
        return by_x * x + by_y * y + by_depth * depth + added

    def matter(self, canonical: Float[Tensor, "3 point"]) -> MatterColumns:
        """What is found at canonical positions."""
        head = self.volume.head
        raw = torch.addmm(head.bias[:, None], head.weight, self.field(canonical))
        density = raw[3] + self.volume.surface_prior(canonical[2])
        return MatterColumns(F.softplus(density), torch.sigmoid(raw[:3]), torch.sigmoid(raw[4]))


def from_pixels(
    maps: Float[Tensor, "frame 3 8"], plane: ImagePlane
) -> tuple[Float[Tensor, "frame 4 4"], Float[Tensor, "frame 4 4"]]:
    """Affine maps and their inverses, homogeneous, from (x, y in pixels, pseudo-depth) instead of local coordinates."""
    scale = plane.half_side
    normalise = torch.diag(maps.new_tensor([1 / scale, 1 / scale, 1.0, 1.0]))
    normalise[:3, 3] = maps.new_tensor([-plane.centre[0] / scale, -plane.centre[1] / scale, -1.0])
    bottom = maps.new_tensor([0.0, 0.0, 0.0, 1.0]).expand(len(maps), 1, 4)
    forward, inverse = (torch.cat([part, bottom], dim=1) for part in maps.split(4, dim=-1))
    return forward @ normalise, torch.linalg.inv(normalise) @ inverse


def _freeze_coupling(layer: CouplingLayer, rows: Tensor) -> FrozenGrid | FrozenNetwork:
    conditioner = layer.conditioner
    if isinstance(conditioner, GridConditioner):
        return FrozenGrid(rows, conditioner.reach)
    return FrozenNetwork(conditioner, rows)


def _axes(layer: CouplingLayer, frozen: FrozenGrid | FrozenNetwork) -> Float[Tensor, "4 4"]:
    """From canonical coordinates to the layer's own, homogeneous."""
    axes = torch.eye(4, dtype=torch.float64)
    axes[:3, :3] = layer.basis.double()
    axes[:2] *= frozen.scale[:, None]
    axes[:2, 3] = frozen.offset
    return axes


class FrozenGrid(nn.Module):
    """A coupling layer's log-scale and shift from the grids of all frames.

    `scale` and `offset` [2] lead from the layer's plane to the coordinates in which it is asked.
    """

    def __init__(self, rows: Float[Tensor, "frame 2 height width"], reach: Float[Tensor, "2"]) -> None:
        super().__init__()
        self.grid = CellGrid(rows, reach)
        self.scale, self.offset = self.grid.scale, self.grid.offset

    def forward(
        self, place: Float[Tensor, "2 point"], frame: Int[Tensor, " point"]
    ) -> tuple[Float[Tensor, "1 point"], Float[Tensor, "1 point"]]:
        """Log-scale and shift at such places."""
        log_scale, shift = self.grid(place, frame).split(1)
        return log_scale, shift


class FrozenNetwork(nn.Module):
    """A coupling layer's log-scale and shift from its network, the codes' part of all frames computed.

    It is asked in the layer's plane itself.
    """

    rows: Tensor

    def __init__(self, conditioner: nn.Module, rows: Float[Tensor, "frame hidden"]) -> None:
        super().__init__()
        self.conditioner = conditioner
        self.register_buffer("rows", rows)
        self.scale, self.offset = torch.ones(2, dtype=torch.float64), torch.zeros(2, dtype=torch.float64)

    def forward(
        self, plane: Float[Tensor, "2 point"], frame: Int[Tensor, " point"]
    ) -> tuple[Float[Tensor, "1 point"], Float[Tensor, "1 point"]]:
        """Log-scale and shift at places in the layer's plane."""
        log_scale, shift = self.conditioner(plane.T[:, None], self.rows, frame)
        return log_scale.T, shift.T


class FrozenGridField(nn.Module):
    """`GridField` with its planes in the form of look-ups."""

    matrix: Tensor
    offset: Tensor

    def __init__(self, field: GridField) -> None:
        super().__init__()
        one, unit = torch.ones(2), torch.diag(1 / field.reach.double())
        image = [CellGrid(plane.detach(), one) for plane in field.image_planes]
        depth = [CellGrid(plane[None].detach(), one) for plane in field.depth_planes]
        axes = [unit[:2]] * len(image) + [unit[axis :: 2 - axis] for axis in range(len(depth))]
        self.planes = nn.ModuleList([*image, *depth])
        grids = [*image, *depth]
        matrix = torch.cat([*(grid.scale[:, None] * each for grid, each in zip(grids, axes, strict=True)), unit])
        offset = torch.cat([*(grid.offset for grid in grids), torch.zeros(3)])
        self.network = field.network
        self.register_buffer("matrix", matrix.float())
        self.register_buffer("offset", offset[:, None].float())

    def forward(self, points: Float[Tensor, "3 point"]) -> Float[Tensor, "width point"]:
        """The MLP's last hidden layer at canonical positions."""
        places = torch.addmm(self.offset, self.matrix, points).split([2] * len(self.planes) + [3])
        values = [plane(place) for plane, place in zip(self.planes, places[:-1], strict=True)]
        hidden = torch.cat([*values, places[-1].clamp(-1, 1)])
        for linear in cast(list[nn.Linear], list(self.network)[::2]):
            hidden = torch.relu(torch.addmm(linear.bias[:, None], linear.weight, hidden))
        return hidden


class ByRows(nn.Module):
    """A field whose points are rows, asked with columns."""

    def __init__(self, field: nn.Module) -> None:
        super().__init__()
        self.field = field

    def forward(self, points: Float[Tensor, "3 point"]) -> Float[Tensor, "width point"]:
        """The field's last hidden layer at canonical positions."""
        return self.field(points.T).T

"""Bilinear look-up in the form that runtimes execute fastest: one gathered row for each point.

Points are columns: every array is [channel, point], so that each operation runs along whole arrays. A grid's row holds
the four corners of one cell, so that a point costs one gather and three interpolations between long arrays; onnxruntime
takes several times as long for `GridSample`, which visits a point once for each channel.
"""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn


class Raster(nn.Module):
    """Where points fall on a raster of `height` x `width` samples; what lies beyond its border is moved onto it.

    Args:
        height, width: samples, at least 2 each.
        scale, offset: (x, y), from the points' coordinates to columns and rows: `scale * point + offset`.
    """

    scale: Tensor
    offset: Tensor
    last: Tensor
    last_cell: Tensor

    def __init__(self, height: int, width: int, scale: tuple[float, float], offset: tuple[float, float]) -> None:
        super().__init__()
        self.height, self.width = height, width
        for name, value in {
            "scale": scale,
            "offset": offset,
            "last": (width - 1.0, height - 1.0),
            "last_cell": (width - 2.0, height - 2.0),
        }.items():
            self.register_buffer(name, torch.tensor(value, dtype=torch.float32)[:, None], persistent=False)

    def forward(self, xy: Float[Tensor, "2 point"]) -> tuple[Float[Tensor, "2 point"], Float[Tensor, "2 point"]]:
        """(column, row) of each point's cell, whole numbers, and the point's place in the cell, 0 to 1."""
        place = torch.minimum((xy * self.scale + self.offset).clamp_min(0.0), self.last)
        cell = torch.minimum(place.floor(), self.last_cell)
        return cell, place - cell


class CellGrid(nn.Module):
    """One grid [channel, height, width] for each frame, over +-`reach` in x and y.

    Args:
        grids: values at the grid's nodes, outermost nodes at +-`reach`.
        reach: (x, y), in the points' coordinates.
    """

    grids: Tensor

    def __init__(self, grids: Float[Tensor, "frame channel height width"], reach: Float[Tensor, "2"]) -> None:
        super().__init__()
        height, width = grids.shape[-2:]
        self.channels = grids.shape[1]
        self.cells = (height - 1) * (width - 1)
        half = ((width - 1) / 2, (height - 1) / 2)
        self.raster = Raster(height, width, (half[0] / float(reach[0]), half[1] / float(reach[1])), half)
        self.register_buffer("grids", grids.permute(0, 2, 3, 1).contiguous(), persistent=False)

    def forward(
        self, xy: Float[Tensor, "2 point"], frame: Int[Tensor, " point"] | None = None
    ) -> Float[Tensor, "channel point"]:
        """The values at `xy`, each point in the grid of its `frame`; None: there is one grid for all."""
        cell, place = self.raster(xy)
        row = (cell[1] * (self.raster.width - 1) + cell[0]).to(torch.int64)
        if frame is not None:
            row = row + frame * self.cells
        corners = self._corners().index_select(0, row).T
        left, right = corners.chunk(2)
        across = left + place[:1] * (right - left)
        upper, lower = across.chunk(2)
        return upper + place[1:] * (lower - upper)

    def _corners(self) -> Float[Tensor, "cell corner_channel"]:
        """A row for each cell: left corners, then right ones, upper before lower; a runtime folds it when it loads."""
        grids = self.grids
        upper, lower = grids[:, :-1], grids[:, 1:]
        rows = [upper[:, :, :-1], lower[:, :, :-1], upper[:, :, 1:], lower[:, :, 1:]]
        return torch.cat(rows, dim=-1).reshape(-1, 4 * self.channels)

"""Bilinear look-up in the form that runtimes execute fastest: one gathered row for each point.

Points are columns: every array is [channel, point], so that each operation runs along whole arrays. A grid's row holds
what is interpolated in one cell, so that a point costs one gather and two multiplications between long arrays;
onnxruntime takes several times as long for `GridSample`, which visits a point once for each channel.

A runtime makes these rows when it loads: they take four times the grids, and nineteen times as long as it makes them,
since it keeps every step. Large tables are therefore left as they are, and a point gathers its four corners.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float, Int, Shaped
from torch import Tensor, nn

EXACT = 2**24
"""Below it, a float32 holds every whole number."""
MOST_UNFOLDED = 16 << 20
"""Bytes of a model's tables up to which a runtime makes rows of them."""


class Raster(nn.Module):
    """Where points fall on the rasters of `frames` frames, of `height` x `width` samples each, at least 2 x 2.

    Asked in samples, (column, row). What lies beyond the border is moved onto it. Cells are numbered row by row, each
    frame by frame: a point that hardly moves meets neighbours; or, with `of_samples`, as their upper left samples are.
    """

    last: Tensor
    stride: Tensor
    steps: Tensor

    def __init__(self, frames: int, height: int, width: int, *, of_samples: bool = False) -> None:
        super().__init__()
        self.frames, self.height, self.width = frames, height, width
        # the largest numbers below the last sample's: rounded down, they give the last cell
        last = np.nextafter(np.array([[width - 1], [height - 1]], np.float32), np.float32(0))
        self.register_buffer("last", torch.from_numpy(last))
        numbers = torch.float32 if frames * height * width < EXACT else torch.float64
        across = width if of_samples else width - 1
        self.register_buffer("stride", torch.tensor([frames, frames * across], dtype=numbers))
        steps = torch.tensor([[0], [frames], [frames * width], [frames * (width + 1)]])
        self.register_buffer("steps", steps)

    def forward(
        self, place: Float[Tensor, "2 point"], frame: Int[Tensor, " point"] | None
    ) -> tuple[Int[Tensor, " point"], Float[Tensor, "2 point"]]:
        """The number of each point's cell in its `frame`, None: the only one, and its place in the cell, 0 to 1."""
        inside = torch.minimum(place.clamp_min(0.0), self.last)
        cell = inside.floor()
        number = (self.stride @ cell.to(self.stride.dtype)).to(torch.int64)
        return number if frame is None else number + frame, inside - cell

    def corners(
        self, samples: Shaped[Tensor, "sample channel"], number: Int[Tensor, " point"]
    ) -> Shaped[Tensor, "4 channel point"]:
        """Upper left, upper right, lower left and lower right sample of each cell, by its number `of_samples`."""
        return samples[number + self.steps].permute(0, 2, 1)


class LookupTable(nn.Module):
    """Samples of a raster, [row, column, frame, channel], in the buffer of that name.

    A runtime makes a row for each cell of them, unless they are to be left as they are.
    """

    def __init__(self, raster: Raster, buffer: str) -> None:
        super().__init__()
        self.raster, self._buffer, self.unfolds = raster, buffer, True

    @property
    def nbytes(self) -> int:
        """Of the samples."""
        return self.get_buffer(self._buffer).nbytes

    def leave_folded(self) -> None:
        """From here on the buffer is [sample, channel], and corners are looked up in it."""
        raster = self.raster
        self.raster, self.unfolds = Raster(raster.frames, raster.height, raster.width, of_samples=True), False
        setattr(self, self._buffer, self.get_buffer(self._buffer).flatten(0, 2))


def spare_memory(model: nn.Module) -> None:
    """Leaves the tables of a model as they are where they have more than `MOST_UNFOLDED` bytes together."""
    tables = [module for module in model.modules() if isinstance(module, LookupTable)]
    if sum(table.nbytes for table in tables) > MOST_UNFOLDED:
        for table in tables:
            table.leave_folded()


class CellGrid(LookupTable):
    """One grid [channel, height, width] for each frame, over +-`reach` in x and y; constant beyond.

    `scale` and `offset` [2] lead to the coordinates in which it is asked: `scale * point + offset` are samples.

    Args:
        grids: values at the grid's nodes, outermost nodes at +-`reach`.
        reach: (x, y), in the points' coordinates.
    """

    grids: Tensor

    def __init__(self, grids: Float[Tensor, "frame channel height width"], reach: Float[Tensor, "2"]) -> None:
        height, width = grids.shape[-2:]
        super().__init__(Raster(len(grids), height, width), "grids")
        self.channels = grids.shape[1]
        self.offset = torch.tensor([width - 1.0, height - 1.0], dtype=torch.float64) / 2
        self.scale = self.offset / reach.double()
        self.register_buffer("grids", grids.permute(2, 3, 0, 1).contiguous())

    def forward(
        self, place: Float[Tensor, "2 point"], frame: Int[Tensor, " point"] | None = None
    ) -> Float[Tensor, "channel point"]:
        """The values at `place`, in samples, each point in the grid of its `frame`; None: there is one grid for all."""
        cell, within = self.raster(place, frame)
        right, down = within.split(1)
        if not self.unfolds:
            upper, lower = self.raster.corners(self.grids, cell).split(2)
            start, end = (upper + down * (lower - upper)).flatten(0, 1).split(self.channels)
            return start + right * (end - start)
        start, slope = self._rows().index_select(0, cell).T.split(2 * self.channels)
        value, descent = (start + right * slope).split(self.channels)
        return value + down * descent

    def _rows(self) -> Float[Tensor, "cell coefficient_channel"]:
        """Of each cell the value at its upper left corner and its step downwards, then what a step to the right adds.

        A runtime computes them from the grids, once, when it loads.
        """
        upper, lower = self.grids[:-1], self.grids[1:]
        columns = torch.cat([upper, lower - upper], dim=-1)
        left, right = columns[:, :-1], columns[:, 1:]
        return torch.cat([left, right - left], dim=-1).reshape(-1, 4 * self.channels)

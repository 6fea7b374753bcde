"""Surfaces: what is seen at a pixel of a frame. Rendered when asked, or looked up in a table that was rendered before.

A table covers each frame with a raster whose longer side is `SIDE` at most. It holds 16-bit codes: of pseudo-depth
(`depth`), or of the canonical position (`full`); their sign is the volume that owns the pixel, negative for the dynamic
one. Between four pixels the owner is the volume with the larger bilinear weight, and only its pixels are averaged: an
outline stays an outline.
"""

from __future__ import annotations

from typing import Literal

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from decomo_export.frozen_rays import FrozenModel, Hit, Part
from decomo_export.lookup import Raster
from decomotion.geometry import ImagePlane
from decomotion.pseudo_depth import FAR

Bake = Literal["none", "depth", "full"]
SIDE = 256
"""Longest side of a table's raster: the finest grids of the `cpu` preset have half as many cells."""
LEVELS = 2**15
"""Codes of each volume."""
RAYS_AT_ONCE = 1 << 14


def build_surfaces(model: FrozenModel, bake: Bake) -> Rendered | BakedSurfaces:
    """The source of surfaces: called with pixels [2, point] and frames [point], it gives a `Hit`."""
    if bake == "none":
        return Rendered(model)
    return BakedSurfaces(model, canonical=bake == "full")


class Rendered(nn.Module):
    """Surfaces by rendering the rays."""

    def __init__(self, model: FrozenModel) -> None:
        super().__init__()
        self.model = model

    def forward(self, xy: Float[Tensor, "2 point"], frame: Int[Tensor, " point"]) -> Hit:
        """The surface at pixels `xy` of each point's `frame`."""
        return self.model.cast(xy, frame).hit()

    def canonical(
        self,
        part: Part,
        values: Float[Tensor, "1 point"],
        xy: Float[Tensor, "2 point"],
        frame: Int[Tensor, " point"],
    ) -> Float[Tensor, "3 point"]:
        """Canonical positions of the surface points `part.asked`, of which the rest are the columns."""
        return part.volume.to_canonical(xy, values.T, frame)


class BakedSurfaces(nn.Module):
    """Surfaces from a table of codes, int16 [row, column, frame, channel]; see the module's docstring.

    Args:
        model: what is rendered into the table.
        canonical: whether the table holds canonical positions (three channels) or pseudo-depth (one).
    """

    scale: Tensor
    offset: Tensor
    codes: Tensor
    lowest: Tensor
    step: Tensor

    def __init__(self, model: FrozenModel, *, canonical: bool) -> None:
        super().__init__()
        self.model, self.holds_canonical = model, canonical
        self.raster = Raster(model.num_frames, *table_size(model.plane))
        scale = torch.tensor([[self.raster.width / model.plane.width], [self.raster.height / model.plane.height]])
        self.register_buffer("scale", scale, persistent=False)
        self.register_buffer("offset", scale / 2 - 0.5, persistent=False)
        values, is_static = self._render()
        self._encode(values, is_static)

    def forward(self, xy: Float[Tensor, "2 point"], frame: Int[Tensor, " point"]) -> Hit:
        """The surface at pixels `xy` of each point's `frame`."""
        row, within = self.raster(xy * self.scale + self.offset, frame)
        right, down = within.split(1)
        across = torch.cat([1 - right, right])
        weights = torch.cat([across * (1 - down), across * down])
        corners = self._rows().index_select(0, row)
        codes = (corners.to(torch.float32).T + 0.5).unflatten(0, (4, -1))  # sign: owner; magnitude: code and a half
        signed = weights[:, None] * codes
        total, magnitude = signed.sum(0), signed.abs().sum(0)
        owners = codes[:, 0].clamp(-0.5, 0.5)  # half of their sign
        balance = 2 * (weights * owners).sum(0)  # static weight less dynamic weight
        is_static = balance >= 0
        owner = torch.where(is_static, 1.0, -1.0)
        return Hit((magnitude + owner * total) / (1 + owner * balance), is_static)

    def canonical(
        self,
        part: Part,
        values: Float[Tensor, "channel point"],
        xy: Float[Tensor, "2 point"],
        frame: Int[Tensor, " point"],
    ) -> Float[Tensor, "3 point"]:
        """Canonical positions of the surface points `part.asked`, of which the rest are the columns."""
        owner = int(part.is_static)
        found = values * self.step[owner] + self.lowest[owner]
        return found if self.holds_canonical else part.volume.to_canonical(xy, found.T, frame)

    def _rows(self) -> Int[Tensor, "cell corner_channel"]:
        """A row for each cell: its corners, row by row; a runtime computes them, once, when it loads."""
        upper, lower = self.codes[:-1], self.codes[1:]
        corners = torch.cat([upper[:, :-1], upper[:, 1:], lower[:, :-1], lower[:, 1:]], dim=-1)
        return corners.flatten(0, 2)

    def _render(self) -> tuple[Float[Tensor, "channel point"], Bool[Tensor, " point"]]:
        """Values and owners of all pixels of all frames, frame by frame, row by row."""
        raster = self.raster
        y, x = torch.meshgrid(torch.arange(raster.height), torch.arange(raster.width), indexing="ij")
        xy = (torch.stack([x, y]).flatten(1) - self.offset) / self.scale
        values, owners = [], []
        with torch.no_grad():
            for frame in range(self.model.num_frames):
                for part in xy.split(RAYS_AT_ONCE, dim=1):
                    frames = torch.full((part.shape[1],), frame)
                    depth, is_static = self.model.cast(part, frames).hit()
                    values.append(self._to_canonical(part, depth, is_static, frames) if self.holds_canonical else depth)
                    owners.append(is_static)
        return torch.cat(values, dim=1), torch.cat(owners)

    def _to_canonical(
        self,
        xy: Float[Tensor, "2 point"],
        depth: Float[Tensor, "1 point"],
        is_static: Bool[Tensor, " point"],
        frame: Int[Tensor, " point"],
    ) -> Float[Tensor, "3 point"]:
        found = xy.new_zeros(3, xy.shape[1])
        for part in self.model.parts(is_static):
            place = part.place
            found[:, place] = part.volume.to_canonical(xy[:, place], depth[:, place].T, frame[place])
        return found

    def _encode(self, values: Float[Tensor, "channel point"], is_static: Bool[Tensor, " point"]) -> None:
        channels = len(values)
        lowest, step, codes = torch.zeros(2, channels, 1), torch.ones(2, channels, 1), torch.zeros_like(values)
        for owner in (False, True):
            of_owner = is_static == owner
            if not of_owner.any():
                continue
            mine = values[:, of_owner]
            if self.holds_canonical:
                low, high = mine.amin(1, keepdim=True), mine.amax(1, keepdim=True)
            else:
                low, high = torch.zeros(1, 1), torch.full((1, 1), FAR)
            apart = (high - low).clamp_min(1e-6) / (LEVELS - 1)
            lowest[int(owner)], step[int(owner)] = low - apart / 2, apart  # `forward` finds codes and a half
            code = ((mine - low) / apart).round().clamp(0.0, LEVELS - 1.0)
            codes[:, of_owner] = code if owner else -1 - code
        table = codes.to(torch.int16).T.reshape(-1, self.raster.height, self.raster.width, channels)
        self.register_buffer("codes", table.permute(1, 2, 0, 3).contiguous(), persistent=False)
        self.register_buffer("lowest", lowest, persistent=False)
        self.register_buffer("step", step, persistent=False)


def table_size(plane: ImagePlane) -> tuple[int, int]:
    """Height and width of a table's raster: the clip's, made smaller where its longer side is above `SIDE`."""
    factor = min(1.0, SIDE / max(plane.height, plane.width))
    return max(2, round(plane.height * factor)), max(2, round(plane.width * factor))

"""Surfaces: what is seen at a pixel of a frame. Rendered when asked, or looked up in a table that was rendered before.

A table covers each frame with a raster whose longer side is `SIDE` at most. It holds 16-bit codes: of pseudo-depth
(`depth`), or of the canonical position (`full`); the lowest bit of the last code is the volume that owns the pixel.
Between four pixels the owner is the volume with the larger bilinear weight, and only its pixels are averaged: an
outline stays an outline.
"""

from __future__ import annotations

from typing import Literal

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from decomo_export.lookup import Raster
from decomo_export.rendering import FrozenModel, Surface
from decomotion.geometry import ImagePlane
from decomotion.rays import FAR

Bake = Literal["none", "depth", "full"]
SIDE = 256
"""Longest side of a table's raster: the finest grids of the `cpu` preset have half as many cells."""
LEVELS = 2**16
RAYS_AT_ONCE = 1 << 14


def build_surfaces(model: FrozenModel, bake: Bake) -> nn.Module:
    """The source of surfaces: called with pixels [2, point] and frames [point], it gives a `Surface`."""
    if bake == "none":
        return Rendered(model)
    return BakedSurfaces(model, canonical=bake == "full")


class Rendered(nn.Module):
    """Surfaces by rendering the rays."""

    def __init__(self, model: FrozenModel) -> None:
        super().__init__()
        self.model = model

    def forward(self, xy: Float[Tensor, "2 point"], frame: Int[Tensor, " point"]) -> Surface:
        """The surface at pixels `xy` of each point's `frame`."""
        return self.model.surface(xy, self.model.cast(xy, frame), frame)


class BakedSurfaces(nn.Module):
    """Surfaces from a table of codes, int16 [frame * row * column, channel]; see the module's docstring.

    Args:
        model: what is rendered into the table.
        canonical: whether the table holds canonical positions (three channels) or pseudo-depth (one).
    """

    codes: Tensor
    lowest: Tensor
    step: Tensor

    def __init__(self, model: FrozenModel, *, canonical: bool) -> None:
        super().__init__()
        self.model, self.canonical = model, canonical
        height, width = raster_size(model.plane)
        scale = (width / model.plane.width, height / model.plane.height)
        self.raster = Raster(height, width, scale, (scale[0] / 2 - 0.5, scale[1] / 2 - 0.5))
        values, is_static = self._render()
        self._encode(values, is_static)

    def forward(self, xy: Float[Tensor, "2 point"], frame: Int[Tensor, " point"]) -> Surface:
        """The surface at pixels `xy` of each point's `frame`."""
        cell, (right, lower) = self.raster(xy)
        width = self.raster.width
        corner = (cell[1] * width + cell[0]).to(torch.int64) + frame * (self.raster.height * width)
        corners = torch.stack([corner, corner + 1, corner + width, corner + width + 1])
        weights = torch.stack([1 - right, right, 1 - right, right])
        weights = weights * torch.stack([1 - lower, 1 - lower, lower, lower])
        codes = self.codes.index_select(0, corners.flatten()).to(torch.float32).T.unflatten(1, (4, -1)) + LEVELS / 2
        last = torch.floor(codes[-1:] / 2)
        owner = codes[-1] - 2 * last[0]  # 1: static
        is_static = (weights * owner).sum(0) >= 0.5
        weights = weights * (owner == is_static.to(owner.dtype))
        values = (torch.cat([codes[:-1], last]) * weights).sum(1) / weights.sum(0)
        static = is_static.to(values.dtype)
        lowest, step = (self._of_owner(pair, static) for pair in (self.lowest, self.step))
        values = values * step + lowest
        if not self.canonical:
            values = self.model.to_canonical(xy, values[0], is_static, frame)
        return Surface(values, is_static)

    @staticmethod
    def _of_owner(
        pair: Float[Tensor, "2 channel 1"], static: Float[Tensor, " point"]
    ) -> Float[Tensor, "channel point"]:
        return pair[0] + (pair[1] - pair[0]) * static

    def _render(self) -> tuple[Float[Tensor, "channel point"], Bool[Tensor, " point"]]:
        """Values and owners of all pixels of all frames, frame by frame, row by row."""
        raster = self.raster
        y, x = torch.meshgrid(torch.arange(raster.height), torch.arange(raster.width), indexing="ij")
        xy = (torch.stack([x, y]).flatten(1) - raster.offset) / raster.scale
        values, owners = [], []
        with torch.no_grad():
            for frame in range(self.model.num_frames):
                for part in xy.split(RAYS_AT_ONCE, dim=1):
                    frames = torch.full((part.shape[1],), frame)
                    rays = self.model.cast(part, frames)
                    surface = self.model.surface(part, rays, frames)
                    values.append(surface.canonical if self.canonical else rays.owner_depth()[None])
                    owners.append(surface.is_static)
        return torch.cat(values, dim=1), torch.cat(owners)

    def _encode(self, values: Float[Tensor, "channel point"], is_static: Bool[Tensor, " point"]) -> None:
        channels = len(values)
        levels = torch.full((channels, 1), LEVELS - 1.0)
        levels[-1] = LEVELS // 2 - 1
        lowest, step, codes = torch.zeros(2, channels, 1), torch.ones(2, channels, 1), torch.zeros_like(values)
        for owner in (False, True):
            of_owner = is_static == owner
            if not of_owner.any():
                continue
            mine = values[:, of_owner]
            if self.canonical:
                low, high = mine.amin(1, keepdim=True), mine.amax(1, keepdim=True)
            else:
                low, high = torch.zeros(1, 1), torch.full((1, 1), FAR)
            lowest[int(owner)], step[int(owner)] = low, (high - low).clamp_min(1e-6) / levels
            codes[:, of_owner] = ((mine - low) / step[int(owner)]).round().clamp_min(0.0).minimum(levels)
        codes[-1] = 2 * codes[-1] + is_static
        self.register_buffer("codes", (codes - LEVELS / 2).to(torch.int16).T.contiguous(), persistent=False)
        self.register_buffer("lowest", lowest, persistent=False)
        self.register_buffer("step", step, persistent=False)


def raster_size(plane: ImagePlane) -> tuple[int, int]:
    """Height and width of a table's raster: the clip's, made smaller where its longer side is above `SIDE`."""
    factor = min(1.0, SIDE / max(plane.height, plane.width))
    return max(2, round(plane.height * factor)), max(2, round(plane.width * factor))

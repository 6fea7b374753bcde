"""Pixels, rays and normalised space: the one place that says where things are.

Pixels      `(x, y)`, centres at integers: the image covers [-0.5, W - 0.5] x [-0.5, H - 0.5].
Units       `(x, y)` on the raster whose longer side is 256, likewise (`decomotion.units`).
Normalised  the image's centre is the origin and its longer side spans [-1, 1]; both axes have the same scale, so
            a similarity in pixels is a similarity here.
Local       `(x, y, z)` of one frame: normalised x and y, and the pseudo-depth z along the orthographic ray,
            larger is farther from the camera.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from decomotion import units


@dataclass(frozen=True)
class ImagePlane:
    """The raster of a clip: `height` and `width` in pixels."""

    height: int
    width: int

    @property
    def half_side(self) -> float:
        """Half of the longer side, in pixels: the length of 1 in normalised coordinates."""
        return max(self.height, self.width) / 2

    @property
    def unit(self) -> float:
        """Length of a unit in pixels."""
        return units.unit(self.height, self.width)

    @property
    def centre(self) -> tuple[float, float]:
        """`(x, y)` of the image's centre in pixels."""
        return (self.width - 1) / 2, (self.height - 1) / 2

    def normalise(self, xy: Float[Tensor, "*batch 2"]) -> Float[Tensor, "*batch 2"]:
        """Pixels to normalised coordinates."""
        return (xy - vector(xy, *self.centre)) / self.half_side

    def to_pixels(self, xy: Float[Tensor, "*batch 2"]) -> Float[Tensor, "*batch 2"]:
        """Normalised coordinates to pixels."""
        return xy * self.half_side + vector(xy, *self.centre)

    def to_units(self, xy: Float[Tensor, "*batch 2"]) -> Float[Tensor, "*batch 2"]:
        """Pixels to units."""
        return units.to_units(xy, self.height, self.width)

    def from_units(self, xy: Float[Tensor, "*batch 2"]) -> Float[Tensor, "*batch 2"]:
        """Units to pixels."""
        return units.from_units(xy, self.height, self.width)


def vector(like: Tensor, *values: float) -> Float[Tensor, " value"]:
    """A vector of the type and on the device of `like`, made there: a recorded CUDA graph cannot copy from the host."""
    return torch.cat([like.new_full((1,), value) for value in values])

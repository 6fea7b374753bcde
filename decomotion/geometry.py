"""Pixels, rays and normalised space: the one place that says where things are.

Pixels      `(x, y)`, centres at integers: the image covers [-0.5, W - 0.5] x [-0.5, H - 0.5].
Normalised  the image's centre is the origin and its longer side spans [-1, 1]; both axes have the same scale, so
            a similarity in pixels is a similarity here.
Local       `(x, y, z)` of one frame: normalised x and y, and the pseudo-depth z along the orthographic ray,
            larger is farther from the camera.
"""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor


@dataclass(frozen=True)
class ImagePlane:
    """The raster of a clip: `height` and `width` in pixels."""

    height: int
    width: int

    @property
    def pixels_per_unit(self) -> float:
        """Length in pixels of one normalised unit."""
        return max(self.height, self.width) / 2

    @property
    def centre(self) -> tuple[float, float]:
        """`(x, y)` of the image's centre in pixels."""
        return (self.width - 1) / 2, (self.height - 1) / 2

    def normalise(self, xy: Float[Tensor, "*batch 2"]) -> Float[Tensor, "*batch 2"]:
        """Pixels to normalised coordinates."""
        return (xy - xy.new_tensor(self.centre)) / self.pixels_per_unit

    def to_pixels(self, xy: Float[Tensor, "*batch 2"]) -> Float[Tensor, "*batch 2"]:
        """Normalised coordinates to pixels."""
        return xy * self.pixels_per_unit + xy.new_tensor(self.centre)

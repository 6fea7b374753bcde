"""Rays of a frozen model: the same rendering as `DecoMotion.cast`, with points as columns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int, Shaped
from torch import Tensor, nn

from decomo_export.frozen import FrozenVolume, Matter
from decomotion.compositing import composite_weights, fused_weights
from decomotion.model.fusion import DecoMotion
from decomotion.model.volume import Volume
from decomotion.rays import sample_depths


class Surface(NamedTuple):
    """The visible surface at some pixels."""

    canonical: Float[Tensor, "3 point"]
    """In the canonical space of the volume that owns the pixel."""
    is_static: Bool[Tensor, " point"]
    """Which volume that is."""


@dataclass(frozen=True)
class FrozenRays:
    """Samples of some rays, near to far, and the share of each in the fused ray."""

    depths: Float[Tensor, " sample"]
    canonical: tuple[Float[Tensor, "3 point sample"], ...]
    """Of the static, then the dynamic volume, as all that follow."""
    matter: tuple[Matter, ...]
    weights: tuple[Float[Tensor, "point sample"], ...]

    def shares(self) -> list[Float[Tensor, " point"]]:
        """Each volume's share of the fused weight."""
        return [weights.sum(-1) for weights in self.weights]

    def is_static(self) -> Bool[Tensor, " point"]:
        """Whether the static volume owns the pixel: whether its share is the larger."""
        static, dynamic = self.shares()
        return static >= dynamic

    def depth(self) -> Float[Tensor, " point"]:
        """Pseudo-depth of the fused ray."""
        weights = self.weights[0] + self.weights[1]
        return (weights * self.depths).sum(-1) / weights.sum(-1).clamp_min(1e-6)

    def owner_depth(self) -> Float[Tensor, " point"]:
        """Pseudo-depth of the surface: of the samples of the volume that owns the pixel."""
        weights = torch.where(self.is_static()[:, None], *self.weights)
        return (weights * self.depths).sum(-1) / weights.sum(-1).clamp_min(1e-6)

    def static_confidence(self) -> Float[Tensor, " point"]:
        """Share of the fused weight that is static."""
        static, dynamic = self.shares()
        return static / (static + dynamic).clamp_min(1e-6)

    def opacities(self) -> list[Float[Tensor, " point"]]:
        """Total weight of each volume's samples where it is alone, at most 1."""
        return [composite_weights(matter.density).sum(-1) for matter in self.matter]

    def colours(self) -> tuple[Float[Tensor, "3 point"], ...]:
        """RGB in [0, 1]: fused; then static alone and dynamic alone, both as if they were opaque."""
        fused = [(weights * matter.colour).sum(-1) for weights, matter in zip(self.weights, self.matter, strict=True)]
        alone = [
            (composite_weights(matter.density) * matter.colour).sum(-1) / opacity.clamp_min(1e-3)
            for matter, opacity in zip(self.matter, self.opacities(), strict=True)
        ]
        return fused[0] + fused[1], *alone


class FrozenModel(nn.Module):
    """Both volumes of a fitted model, frozen.

    Args:
        model: the fitted model.
    """

    def __init__(self, model: DecoMotion) -> None:
        super().__init__()
        self.plane, self.config, self.num_frames = model.plane, model.config, model.num_frames
        with torch.no_grad():
            conditioning = model.condition(torch.arange(model.num_frames))
            self.static, self.dynamic = (
                FrozenVolume(volume, rows, model.plane) if isinstance(volume, Volume) else None
                for volume, rows in zip((model.static, model.dynamic), conditioning, strict=True)
            )

    def cast(self, xy: Float[Tensor, "2 point"], frame: Int[Tensor, " point"]) -> FrozenRays:
        """Samples the rays through pixels `xy`, each of its `frame`."""
        samples = self.config.samples
        depths = sample_depths(xy.new_zeros(2), samples)
        shape = (xy.shape[1], samples)
        each = xy[:, :, None].expand(2, *shape).flatten(1)
        depth, frames = depths.expand(shape).flatten(), frame[:, None].expand(shape).flatten()
        canonical, matter = [], []
        for volume in (self.static, self.dynamic):
            if volume is None:
                nothing = torch.zeros_like(depth)
                points, found = nothing.expand(3, -1), Matter(nothing, nothing.expand(3, -1), nothing)
            else:
                points = volume.to_canonical(each, depth, frames)
                found = volume.matter(points)
            canonical.append(points.unflatten(1, shape))
            matter.append(
                Matter(
                    found.density.unflatten(0, shape),
                    found.colour.unflatten(1, shape),
                    found.confidence.unflatten(0, shape),
                )
            )
        static, dynamic = matter
        beta = torch.ones_like(static.confidence) if self.dynamic is None else static.confidence
        weights = fused_weights(static.density, dynamic.density, beta)
        return FrozenRays(depths, tuple(canonical), tuple(matter), tuple(weights))

    def surface(self, xy: Float[Tensor, "2 point"], rays: FrozenRays, frame: Int[Tensor, " point"]) -> Surface:
        """The surface that `rays` meet, as `decomotion.model.readout.surface_of` defines it."""
        is_static = rays.is_static()
        return Surface(self.to_canonical(xy, rays.owner_depth(), is_static, frame), is_static)

    def to_canonical(
        self,
        xy: Float[Tensor, "2 point"],
        depth: Float[Tensor, " point"],
        is_static: Bool[Tensor, " point"],
        frame: Int[Tensor, " point"],
    ) -> Float[Tensor, "3 point"]:
        """Canonical positions of points, each in the volume that owns it."""
        return self._by_owner(is_static, 3, FrozenVolume.to_canonical, xy, depth, frame)

    def to_pixels(self, surface: Surface, frame: Int[Tensor, " point"]) -> Float[Tensor, "2 point"]:
        """Pixels at which surface points lie in their `frame`."""
        return self._by_owner(surface.is_static, 2, FrozenVolume.to_pixels, surface.canonical, frame)

    def _by_owner(
        self,
        is_static: Bool[Tensor, " point"],
        channels: int,
        ask: Callable[..., Float[Tensor, "channel point"]],
        *columns: Shaped[Tensor, "..."],
    ) -> Float[Tensor, "channel point"]:
        """What `ask` says of each point in the volume that owns it; no volume is asked about the other's points."""
        if self.static is None or self.dynamic is None:
            return ask(self.static or self.dynamic, *columns)
        first = torch.zeros(1, dtype=torch.int64)
        found, places = [], []
        for volume, owned in ((self.static, is_static), (self.dynamic, ~is_static)):
            place = torch.nonzero(owned)[:, 0]
            asked = torch.cat([place, first])  # never empty: some of onnxruntime's operators mislay empty axes
            found.append(ask(volume, *(column.index_select(-1, asked) for column in columns))[:, :-1])
            places.append(place)
        order = torch.cat(places).expand(channels, -1)
        blank = columns[0].new_zeros(channels, is_static.shape[0])
        return blank.scatter(1, order, torch.cat(found, dim=1))

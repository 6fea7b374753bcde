"""Rays of a frozen model: the same rendering as `DecoMotion.cast`, with points as columns."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from decomo_export.frozen import FrozenVolume, MatterColumns
from decomotion.compositing import as_if_opaque, composite_weights, fused_weights, static_share, thickened
from decomotion.model.fusion import DecoMotion
from decomotion.model.readout import static_owns
from decomotion.model.volume import Volume
from decomotion.rays import sample_depths


class Hit(NamedTuple):
    """Where the rays of some pixels hit the visible surface; not yet its place in canonical space."""

    values: Float[Tensor, "channel point"]
    """Pseudo-depth, or what a table holds instead (`baking.py`)."""
    is_static: Bool[Tensor, " point"]
    """Which volume owns the pixel."""


@dataclass(frozen=True)
class Part:
    """Those of some points that belong to one volume."""

    volume: FrozenVolume
    is_static: bool
    """Which volume that is."""
    place: Int[Tensor, " part"]
    """Their numbers among all points."""
    asked: Int[Tensor, " part_1"]
    """The same and one more, never empty: some of onnxruntime's operators mislay empty axes."""

    def of(self, columns: Float[Tensor, "channel point"]) -> Float[Tensor, "channel part_1"]:
        """The columns of the points `asked`, taken as rows, which is faster."""
        return columns.T.index_select(0, self.asked).T


@dataclass(frozen=True)
class FrozenRays:
    """Samples of some rays, near to far, and the share of each in the fused ray."""

    depths: Float[Tensor, " sample"]
    matter: tuple[MatterColumns, ...]
    """Of the static, then the dynamic volume, as all that follow."""
    weights: tuple[Float[Tensor, "point sample"], ...]

    def totals(self) -> list[Float[Tensor, " point"]]:
        """Each volume's part of the fused weight."""
        return [weights.sum(-1) for weights in self.weights]

    def static_confidence(self) -> Float[Tensor, " point"]:
        """Share of the fused weight that is static."""
        return static_share(*self.totals())

    def is_static(self) -> Bool[Tensor, " point"]:
        """Whether the static volume owns the pixel."""
        return static_owns(self.static_confidence())

    def depth(self) -> Float[Tensor, " point"]:
        """Pseudo-depth of the fused ray."""
        weights = self.weights[0] + self.weights[1]
        return (weights * self.depths).sum(-1) / weights.sum(-1).clamp_min(1e-6)

    def owner_depth(self) -> Float[Tensor, " point"]:
        """Pseudo-depth of the surface: of the samples of the volume that owns the pixel."""
        weights = torch.where(self.is_static()[:, None], *self.weights)
        return (weights * self.depths).sum(-1) / weights.sum(-1).clamp_min(1e-6)

    def hit(self) -> Hit:
        """What `decomotion.model.readout.surface_of` takes for the visible surface."""
        return Hit(self.owner_depth()[None], self.is_static())

    @cached_property
    def alone(self) -> list[Float[Tensor, "point sample"]]:
        """Weights of each volume's samples where it is alone."""
        return [composite_weights(matter.density) for matter in self.matter]

    def opacities(self) -> list[Float[Tensor, " point"]]:
        """Their sum, at most 1."""
        return [weights.sum(-1) for weights in self.alone]

    def colours(self) -> tuple[Float[Tensor, "3 point"], ...]:
        """RGB in [0, 1]: fused; then static alone and dynamic alone, both as if they were opaque."""
        fused = [(weights * matter.colour).sum(-1) for weights, matter in zip(self.weights, self.matter, strict=True)]
        alone = [(weights * matter.colour).sum(-1) for weights, matter in zip(self.alone, self.matter, strict=True)]
        static, dynamic = self.totals()
        opaque = [as_if_opaque(colour, opacity) for colour, opacity in zip(alone, self.opacities(), strict=True)]
        return thickened(fused[0] + fused[1], static + dynamic), *opaque


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
        depths = sample_depths(xy.new_zeros(2), self.config.samples)
        shape = (xy.shape[1], self.config.samples)
        nothing, one = (xy.new_full((1, 1), value).expand(shape) for value in (0.0, 1.0))  # other ways fix the size
        matter = []
        for volume in (self.static, self.dynamic):
            if volume is None:
                matter.append(MatterColumns(nothing, nothing.expand(3, *shape), nothing))
                continue
            found = volume.matter(volume.to_canonical(xy, depths[None], frame))
            matter.append(
                MatterColumns(
                    found.density.unflatten(0, shape),
                    found.colour.unflatten(1, shape),
                    found.confidence.unflatten(0, shape),
                )
            )
        static, dynamic = matter
        beta = one if self.dynamic is None else static.confidence
        weights = fused_weights(static.density, dynamic.density, beta)
        return FrozenRays(depths, tuple(matter), tuple(weights))

    def parts(self, is_static: Bool[Tensor, " point"], wanted: Bool[Tensor, " point"] | None = None) -> list[Part]:
        """The points that are `wanted`, by default all, by owner: no volume is asked about the other's points."""
        wanted = is_static | ~is_static if wanted is None else wanted  # not ones_like: it would fix the traced size
        alone = self.static is None or self.dynamic is None
        first = torch.zeros(1, dtype=torch.int64)
        parts = []
        for volume, static, owned in ((self.static, True, is_static), (self.dynamic, False, ~is_static)):
            if volume is not None:
                place = torch.nonzero(wanted if alone else owned & wanted)[:, 0]
                parts.append(Part(volume, static, place, torch.cat([place, first])))
        return parts

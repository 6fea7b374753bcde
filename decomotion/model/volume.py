"""One canonical volume: how each frame's points map into it, and what is found there."""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor, nn

from decomotion.geometry import vector
from decomotion.model.affine import AffineTransform
from decomotion.model.config import VolumeConfig
from decomotion.model.coupling import CouplingLayer
from decomotion.model.field import build_field


@dataclass(frozen=True)
class Conditioning:
    """What the transforms of some frames need, computed once for the frames and used for all of their points."""

    affine: Float[Tensor, "frame 3 8"]
    couplings: tuple[Float[Tensor, "frame ..."], ...]

    def take(self, frame: Int[Tensor, " row"]) -> Conditioning:
        """The conditioning of the rows `frame`, copied out."""
        return Conditioning(
            self.affine.index_select(0, frame), tuple(layer.index_select(0, frame) for layer in self.couplings)
        )


@dataclass(frozen=True)
class Matter:
    """What a volume holds at canonical positions."""

    density: Float[Tensor, "*batch"]
    """sigma, non-negative."""
    colour: Float[Tensor, "*batch 3"]
    """RGB in [0, 1]."""
    confidence: Float[Tensor, "*batch"]
    """beta, the static confidence in [0, 1]; of no meaning in the dynamic volume."""


class Volume(nn.Module):
    """A static or a dynamic canonical volume with its transforms (paper, T = M(A(x); phi_i)).

    Args:
        config: the volume's leaf of the configuration.
        code_size: length of the frame codes.
        start: [frame, 3, 4], affine maps from local to canonical space that training begins with.
        extent: half the size of the canonical box in which points are expected.
    """

    def __init__(
        self,
        config: VolumeConfig,
        code_size: int,
        start: Float[Tensor, "frame 3 4"],
        extent: Float[Tensor, "3"],
    ) -> None:
        super().__init__()
        self.surface = config.surface
        self.affine = AffineTransform(code_size, config.affine_hidden, start)
        directions = [config.directions[index % len(config.directions)] for index in range(config.couplings)]
        self.couplings = nn.ModuleList(
            CouplingLayer(direction, config.conditioner, code_size, extent) for direction in directions
        )
        self.field = build_field(config.field, extent)
        self.head = nn.Linear(config.field.width, 5)

    def condition(self, codes: Float[Tensor, "all code"], frames: Int[Tensor, " frame"]) -> Conditioning:
        """Conditioning of `frames`, given the codes of all frames."""
        couplings = tuple(layer.condition(codes.index_select(0, frames)) for layer in self._layers())
        return Conditioning(self.affine.condition(codes).index_select(0, frames), couplings)

    def to_canonical(
        self,
        points: Float[Tensor, "batch point 3"],
        conditioning: Conditioning,
        frame: Int[Tensor, " batch"] | None = None,
    ) -> Float[Tensor, "batch point 3"]:
        """Local to canonical. `frame` picks each batch row's row of `conditioning`; None where they correspond."""
        maps = conditioning.affine if frame is None else conditioning.affine.index_select(0, frame)
        points = self.affine.to_canonical(centred(points), maps)
        for layer, rows in zip(self._layers(), conditioning.couplings, strict=True):
            points = layer.to_canonical(points, rows, frame)
        return points

    def from_canonical(
        self,
        points: Float[Tensor, "batch point 3"],
        conditioning: Conditioning,
        frame: Int[Tensor, " batch"] | None = None,
    ) -> Float[Tensor, "batch point 3"]:
        """Canonical to local, the exact inverse of `to_canonical`."""
        maps = conditioning.affine if frame is None else conditioning.affine.index_select(0, frame)
        for layer, rows in zip(reversed(self._layers()), reversed(conditioning.couplings), strict=True):
            points = layer.from_canonical(points, rows, frame)
        return decentred(self.affine.from_canonical(points, maps))

    def matter(self, points: Float[Tensor, "*batch 3"]) -> Matter:
        """Density, colour and static confidence at canonical positions."""
        raw = self.head(self.field(points.reshape(-1, 3))).reshape(*points.shape[:-1], 5)
        density = raw[..., 3] + self.surface_prior(points[..., 2])
        return Matter(F.softplus(density), torch.sigmoid(raw[..., :3]), torch.sigmoid(raw[..., 4]))

    def surface_prior(self, z: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
        """What is added to the raw density: a sheet at the configured depth, or -1 everywhere as in OmniMotion."""
        if self.surface is None:
            return torch.full_like(z, -1.0)
        offset = (z - (self.surface.depth - 1)) / self.surface.thickness
        return self.surface.peak * (1 - offset * offset).clamp_min(-1.0)

    def _layers(self) -> list[CouplingLayer]:
        return list(self.couplings)  # type: ignore[arg-type]


class EmptyVolume(nn.Module):
    """The place of a volume that a model does without: it moves nothing and holds nothing, at no cost.

    With it on one side, the fused model is OmniMotion's single volume.
    """

    def condition(self, codes: Float[Tensor, "all code"], frames: Int[Tensor, " frame"]) -> Conditioning:
        """Nothing that depends on the frame."""
        return Conditioning(codes.new_zeros(len(frames), 3, 8), ())

    def to_canonical(
        self,
        points: Float[Tensor, "batch point 3"],
        conditioning: Conditioning,
        frame: Int[Tensor, " batch"] | None = None,
    ) -> Float[Tensor, "batch point 3"]:
        """The points."""
        del conditioning, frame
        return points

    from_canonical = to_canonical

    def matter(self, points: Float[Tensor, "*batch 3"]) -> Matter:
        """No density."""
        nothing = torch.zeros_like(points[..., 0])
        return Matter(nothing, torch.zeros_like(points), nothing)


def centred(points: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Local depth [0, 2] to [-1, 1], so that the transforms act about the middle of the volume."""
    return points - vector(points, 0.0, 0.0, 1.0)


def decentred(points: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """The inverse of `centred`."""
    return points + vector(points, 0.0, 0.0, 1.0)

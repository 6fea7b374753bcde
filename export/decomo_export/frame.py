"""One frame's rays, all of its pixels: the same rendering as `DecoMotion.cast`, for tables.

What belongs to the frame is looked up once, not for every point; colours are left out; one product leads from one
coupling layer's axes to the next one's, as in `frozen.py`.
"""

from __future__ import annotations

from itertools import pairwise
from typing import cast

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from decomo_export.frozen import from_pixels
from decomo_export.frozen_rays import FrozenRays, Hit
from decomotion.compositing import fused_weights
from decomotion.geometry import ImagePlane
from decomotion.model.coupling import CouplingLayer
from decomotion.model.fusion import DecoMotion, PairConditioning
from decomotion.model.volume import Conditioning, Volume
from decomotion.rays import sample_depths


class FrameVolume:
    """One volume as one frame sees it.

    Args:
        volume: the fitted volume.
        conditioning: of the frame alone.
        plane: the clip's raster.
    """

    def __init__(self, volume: Volume, conditioning: Conditioning, plane: ImagePlane) -> None:
        self.volume, self.conditioning = volume, conditioning
        self.layers = cast(list[CouplingLayer], list(volume.couplings))
        canonical = torch.eye(3, dtype=torch.float64, device=conditioning.affine.device)
        axes = [*(layer.basis.double() for layer in self.layers), canonical]
        maps, _ = from_pixels(conditioning.affine.double(), plane)
        self.first = (axes[0] @ maps[0, :3]).float()
        self.turns = [(after @ before.T).float() for before, after in pairwise(axes)]

    def to_canonical(
        self, xy: Float[Tensor, "2 point"], depth: Float[Tensor, "_ sample"]
    ) -> Float[Tensor, "3 point_sample"]:
        """Canonical positions of points at pixels `xy`, at pseudo-depths of their own, or of all."""
        by_place, by_depth, added = self.first.split([2, 1, 1], dim=1)
        nearest = torch.addmm(added, by_place, xy)
        turned = (by_depth[:, :, None] * depth + nearest[:, :, None]).flatten(1)
        for layer, rows, turn in zip(self.layers, self.conditioning.couplings, self.turns, strict=True):
            log_scale, shift = layer.conditioner(turned[:2].T[None], rows, None)
            turned[2].mul_(log_scale[0].exp_()).add_(shift[0])
            turned = turn @ turned
        return turned

    def density_and_confidence(
        self, xy: Float[Tensor, "2 point"], depths: Float[Tensor, " sample"]
    ) -> tuple[Float[Tensor, "point sample"], Float[Tensor, "point sample"]]:
        """What rays need to know of the matter along them, as `decomotion.model.volume.Matter`."""
        canonical = self.to_canonical(xy, depths[None])
        head = self.volume.head
        density, confidence = F.linear(self.volume.field(canonical.T), head.weight[3:], head.bias[3:]).unbind(-1)
        density = F.softplus(density + self.volume.surface_prior(canonical[2]))
        return density.unflatten(0, (-1, len(depths))), torch.sigmoid(confidence).unflatten(0, (-1, len(depths)))


class FrameModel:
    """A fitted model as one frame sees it.

    Args:
        model: the fitted model.
        conditioning: of the frame alone.
    """

    def __init__(self, model: DecoMotion, conditioning: PairConditioning) -> None:
        self.depths = sample_depths(next(model.parameters()).new_zeros(2), model.config.samples)
        self.static, self.dynamic = (
            FrameVolume(volume, rows, model.plane) if isinstance(volume, Volume) else None
            for volume, rows in zip((model.static, model.dynamic), conditioning, strict=True)
        )

    def hit(self, xy: Float[Tensor, "2 point"]) -> Hit:
        """Where the rays through pixels `xy` hit the visible surface: its pseudo-depth, and its owner."""
        nothing = xy.new_zeros(xy.shape[1], len(self.depths))
        (static, confidence), (dynamic, _) = (
            (nothing, nothing) if volume is None else volume.density_and_confidence(xy, self.depths)
            for volume in (self.static, self.dynamic)
        )
        beta = torch.ones_like(confidence) if self.dynamic is None else confidence
        return FrozenRays(self.depths, (), fused_weights(static, dynamic, beta)).hit()

    def canonical(self, xy: Float[Tensor, "2 point"], hit: Hit) -> Float[Tensor, "3 point"]:
        """Canonical positions of what was hit, each in the space of its owner."""
        found = xy.new_empty(3, xy.shape[1])
        for volume, owned in ((self.static, hit.is_static), (self.dynamic, ~hit.is_static)):
            if volume is not None:
                found[:, owned] = volume.to_canonical(xy[:, owned], hit.values[:, owned].T)
        return found

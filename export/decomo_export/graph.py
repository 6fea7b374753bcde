"""What is exported: one module whose `forward` is the runtime's question."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from decomo_export.baking import Bake, build_surfaces
from decomo_export.rendering import FrozenModel, Surface
from decomotion.model.fusion import DecoMotion

ARRAYS_IN_USE = 4
NARROWEST = 64
"""Floats that a grid's look-up holds for each point, at least."""


class QueryGraph(nn.Module):
    """Query points and target frames in; tracks, occlusion and the appearance of the queries' own rays out.

    Axes, units and names are those of `decomo_runtime.contract`; the answer is the one that
    `decomotion.model.readout.answer` defines, with surfaces rendered or from a table.

    Args:
        model: the fitted model.
        bake: where surfaces come from.
    """

    def __init__(self, model: DecoMotion, bake: Bake = "none") -> None:
        super().__init__()
        self.model = FrozenModel(model)
        self.surfaces = build_surfaces(self.model, bake)
        self.bake = bake

    @property
    def bytes_per_ray(self) -> int:
        """Working memory, roughly, of one query in one frame: samples, times widest layer, times arrays in use."""
        widest = max(module.out_features for module in self.model.modules() if isinstance(module, nn.Linear))
        samples = self.model.config.samples if self.bake == "none" else 1
        return 4 * samples * ARRAYS_IN_USE * max(NARROWEST, widest)

    def forward(
        self, queries: Float[Tensor, "query 3"], frames: Int[Tensor, " frame"]
    ) -> tuple[
        Float[Tensor, "query frame 2"],
        Float[Tensor, "query frame"],
        Float[Tensor, "query 3"],
        Float[Tensor, "query 3"],
        Float[Tensor, "query 3"],
        Float[Tensor, " query"],
        Float[Tensor, " query"],
        Float[Tensor, " query"],
    ]:
        """tracks, occlusion, rgb, rgb_static, rgb_dynamic, static_confidence, depth, static_opacity."""
        xy, frame = queries[:, 1:].T, queries[:, 0].to(torch.int64)
        rays = self.model.cast(xy, frame)
        surface = self.model.surface(xy, rays, frame) if self.bake == "none" else self.surfaces(xy, frame)
        tracks, occlusion = self._follow(xy, frame, surface, frames)
        rgb, rgb_static, rgb_dynamic = (colour.T for colour in rays.colours())
        seen = rays.static_confidence(), rays.depth(), rays.opacities()[0]
        return tracks, occlusion, rgb, rgb_static, rgb_dynamic, *seen

    def _follow(
        self,
        query_xy: Float[Tensor, "2 query"],
        query_frame: Int[Tensor, " query"],
        surface: Surface,
        frames: Int[Tensor, " frame"],
    ) -> tuple[Float[Tensor, "query frame 2"], Float[Tensor, "query frame"]]:
        """Places and occlusion of the queries' surface points in `frames`."""
        model, plane = self.model, self.model.plane
        shape = (query_xy.shape[1], frames.shape[0])
        start = _for_each_frame(query_xy, shape)
        source = query_frame[:, None].expand(shape).flatten()
        target = frames.expand(shape).flatten()
        point = Surface(_for_each_frame(surface.canonical, shape), surface.is_static[:, None].expand(shape).flatten())
        at_home = source == target
        there = torch.where(at_home, start, model.to_pixels(point, target))

        last = there.new_tensor([[plane.width - 1.0], [plane.height - 1.0]])
        inside = torch.minimum(there.clamp_min(0.0), last)
        gone = ((there < -0.5) | (there > last + 0.5)).any(0)
        offset = model.to_pixels(self.surfaces(inside, target), source) - start
        error = (offset * offset).sum(0).sqrt() * (128 / plane.pixels_per_unit)
        hidden = torch.where(gone, torch.ones_like(error), error / (error + model.config.occlusion_scale))
        occlusion = torch.where(at_home, torch.zeros_like(hidden), hidden)
        return there.T.unflatten(0, shape), occlusion.unflatten(0, shape)


def _for_each_frame(values: Float[Tensor, "channel query"], shape: tuple) -> Tensor:
    """Each query's column once for each frame, [channel, query * frame]."""
    return values[:, :, None].expand(-1, *shape).flatten(1)

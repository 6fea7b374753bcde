"""What is exported: one module whose `forward` is the runtime's question."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from decomo_export.baking import Bake, build_surfaces
from decomo_export.frozen_rays import FrozenModel, Hit
from decomo_export.lookup import spare_memory
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
        self.surfaces = build_surfaces(model, self.model, bake)
        spare_memory(self)
        self.bake = bake

    @property
    def bytes_per_ray(self) -> int:
        """Working memory, roughly, of one query in one frame; where surfaces are baked, no ray is sampled."""
        return self._bytes(self.model.config.samples if self.bake == "none" else 1)

    @property
    def bytes_per_rendered_ray(self) -> int:
        """Working memory, roughly, of one query's own ray, all of whose samples are rendered."""
        return self._bytes(self.model.config.samples)

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
        hit = rays.hit() if self.bake == "none" else self.surfaces(xy, frame)
        tracks, occlusion = self._track(xy, frame, hit, frames)
        rgb, rgb_static, rgb_dynamic = (colour.T for colour in rays.colours())
        seen = rays.static_confidence(), rays.depth(), rays.opacities()[0]
        return tracks, occlusion, rgb, rgb_static, rgb_dynamic, *seen

    def track(
        self, queries: Float[Tensor, "query 3"], frames: Int[Tensor, " frame"]
    ) -> tuple[Float[Tensor, "query frame 2"], Float[Tensor, "query frame"]]:
        """tracks and occlusion alone: what the file computes where frames are asked for (`lazy.py`)."""
        xy, frame = queries[:, 1:].T, queries[:, 0].to(torch.int64)
        hit = self.model.cast(xy, frame).hit() if self.bake == "none" else self.surfaces(xy, frame)
        return self._track(xy, frame, hit, frames)

    def _track(
        self,
        xy: Float[Tensor, "2 query"],
        frame: Int[Tensor, " query"],
        hit: Hit,
        frames: Int[Tensor, " target"],
    ) -> tuple[Float[Tensor, "query target 2"], Float[Tensor, "query target"]]:
        there = self._carry(xy, frame, hit, frames)
        at_home = frame[:, None] == frames
        there = torch.where(at_home, xy[:, :, None], there)
        occlusion = self._occlusion(xy, frame, there.flatten(1), frames, at_home.flatten())
        return there.permute(1, 2, 0), occlusion

    def _bytes(self, samples: int) -> int:
        """Samples, times widest layer, times arrays in use."""
        widest = max(module.out_features for module in self.model.modules() if isinstance(module, nn.Linear))
        return 4 * samples * ARRAYS_IN_USE * max(NARROWEST, widest)

    def _carry(
        self,
        xy: Float[Tensor, "2 query"],
        frame: Int[Tensor, " query"],
        hit: Hit,
        frames: Int[Tensor, " target"],
    ) -> Float[Tensor, "2 query target"]:
        """Pixels of `frames` at which the queries' surface points are."""
        found, places = [], []
        for part in self.model.parts(hit.is_static):
            values, place = part.of(torch.cat([hit.values, xy])).split([len(hit.values), 2])
            canonical = self.surfaces.canonical(part, values, place, frame.index_select(0, part.asked))
            shape = (canonical.shape[1], frames.shape[0])
            each = canonical[:, :, None].expand(3, *shape).flatten(1)
            pixels = part.volume.to_pixels(each, frames.expand(shape).flatten()).unflatten(1, shape)
            found.append(pixels[:, :-1])
            places.append(part.place)
        order = torch.cat(places)
        back = torch.zeros_like(frame).scatter(0, order, torch.arange(order.shape[0]))
        return torch.cat(found, dim=1).index_select(1, back)

    def _occlusion(
        self,
        xy: Float[Tensor, "2 query"],
        frame: Int[Tensor, " query"],
        there: Float[Tensor, "2 point"],
        frames: Int[Tensor, " target"],
        at_home: Bool[Tensor, " point"],
    ) -> Float[Tensor, "query target"]:
        """How far the surface seen `there` is from the query's, as a score; outside the image 1, `at_home` 0."""
        plane, shape = self.model.plane, (frame.shape[0], frames.shape[0])
        last = there.new_tensor([[plane.width - 1.0], [plane.height - 1.0]])
        inside = torch.minimum(there.clamp_min(0.0), last)
        gone = ((there < -0.5) | (there > last + 0.5)).any(0)
        start = xy[:, :, None].expand(2, *shape).flatten(1)
        source, target = frame[:, None].expand(shape).flatten(), frames.expand(shape).flatten()
        hit = self.surfaces(inside, target)
        columns = torch.cat([hit.values, inside, start, torch.stack([target, source]).to(there.dtype)])
        scores, places = [], []
        for part in self.model.parts(hit.is_static, ~(gone | at_home)):
            values, seen, begun, clock = part.of(columns).split([len(hit.values), 2, 2, 2])
            seen_in, begun_in = clock.to(torch.int64)
            canonical = self.surfaces.canonical(part, values, seen, seen_in)
            offset = part.volume.to_pixels(canonical, begun_in) - begun
            error = (offset * offset).sum(0).sqrt() * (1 / plane.unit)
            scores.append((error / (error + self.model.config.occlusion_scale))[:-1])
            places.append(part.place)
        elsewhere = (~at_home).to(there.dtype)
        return elsewhere.scatter(0, torch.cat(places), torch.cat(scores)).unflatten(0, shape)

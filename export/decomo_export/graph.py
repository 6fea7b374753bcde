"""What is exported: one module whose `forward` is the runtime's question."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from decomotion.compositing import composite, composite_weights
from decomotion.model.fusion import DecoMotion, PairConditioning
from decomotion.model.readout import answer
from decomotion.model.volume import Conditioning


class QueryGraph(nn.Module):
    """Query points and target frames in; tracks, occlusion and the appearance of the queries' own rays out.

    Axes, units and names are those of `decomo_runtime.contract`. The frames' codes enter only through the
    conditioning of the transforms, which is computed here, once, and frozen as constants.

    Args:
        model: the fitted model.
    """

    def __init__(self, model: DecoMotion) -> None:
        super().__init__()
        self.model = model
        with torch.no_grad():
            conditioning = model.condition(torch.arange(model.num_frames))
        self._layers = {}
        for name, volume in zip(conditioning._fields, conditioning, strict=True):
            self.register_buffer(f"{name}_affine", volume.affine)
            for index, layer in enumerate(volume.couplings):
                self.register_buffer(f"{name}_coupling_{index}", layer)
            self._layers[name] = len(volume.couplings)

    def conditioning(self) -> PairConditioning:
        """The frozen conditioning of all frames."""
        return PairConditioning(
            *(
                Conditioning(
                    self.get_buffer(f"{name}_affine"),
                    tuple(self.get_buffer(f"{name}_coupling_{index}") for index in range(layers)),
                )
                for name, layers in self._layers.items()
            )
        )

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
    ]:
        """tracks, occlusion, rgb, rgb_static, rgb_dynamic, static_confidence, depth."""
        conditioning = self.conditioning()
        frame, xy = queries[:, 0].to(torch.int64), queries[:, 1:]
        rays = self.model.cast(xy[:, None], conditioning, frame)
        result = answer(self.model, conditioning, rays, xy, frame, frames)
        weights = rays.fused_static + rays.fused_dynamic
        depth = composite(weights, rays.depths[..., None])[:, 0, 0] / rays.opacity[:, 0].clamp_min(1e-6)
        return (
            result.xy,
            result.occlusion,
            rays.fused_colour()[:, 0],
            composite(composite_weights(rays.static.density), rays.static.colour)[:, 0],
            composite(composite_weights(rays.dynamic.density), rays.dynamic.colour)[:, 0],
            rays.static_confidence[:, 0],
            depth,
        )

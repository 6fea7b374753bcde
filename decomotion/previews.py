"""Preview pictures of a fit: what the model renders of one frame, layer by layer."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import torch
from jaxtyping import Float
from torch import Tensor

from decomotion.compositing import as_if_opaque, composite, thickened
from decomotion.model.fusion import DecoMotion
from decomotion.pseudo_depth import FAR

SIDE = 128
"""Longer side of a preview in pixels."""


@torch.no_grad()
def render_layers(model: DecoMotion, frame: int, side: int = SIDE) -> npt.NDArray[np.uint8]:
    """Fused colour, static scene, dynamic objects, static confidence and pseudo-depth, side by side.

    Returns RGB [h, 5 * w, 3].
    """
    device = next(model.parameters()).device
    plane = model.plane
    scale = min(1.0, side / max(plane.height, plane.width))
    height, width = max(1, round(plane.height * scale)), max(1, round(plane.width * scale))
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    xy = (torch.stack([x, y], dim=-1).float() + 0.5) / scale - 0.5
    conditioning = model.condition(torch.tensor([frame], device=device))
    rows = []
    for chunk in xy.reshape(1, -1, 2).to(device).split(4096, dim=1):
        rays = model.cast(chunk, conditioning)
        weights = rays.fused_static + rays.fused_dynamic
        depth = (composite(weights, rays.depths[..., None]) / rays.opacity.clamp_min(1e-3)[..., None]) / FAR
        confidence = rays.static_confidence[..., None]
        static = _alone(rays.alone_static, rays.static.colour)
        dynamic = _alone(rays.alone_dynamic, rays.dynamic.colour)
        objects = dynamic * (1 - confidence) + confidence
        fused = thickened(rays.fused_colour(), rays.opacity[..., None])
        layers = [fused, static, objects, confidence.expand_as(static), depth.expand_as(static)]
        rows.append(torch.stack(layers, dim=2))
    picture = torch.cat(rows, dim=1).clamp(0, 1).reshape(height, width, 5, 3)
    return (picture.permute(0, 2, 1, 3).reshape(height, 5 * width, 3) * 255).round().byte().cpu().numpy()


def _alone(
    weights: Float[Tensor, "1 point sample"], colour: Float[Tensor, "1 point sample 3"]
) -> Float[Tensor, "1 point 3"]:
    """Colour of a volume alone."""
    return as_if_opaque(composite(weights, colour), weights.sum(-1, keepdim=True))

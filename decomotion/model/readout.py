"""Answers: where a query point is in other frames, and whether it is hidden there.

A query's ray is rendered once. The point that is carried to the other frames is the surface that the ray meets, in
canonical space, of the volume that owns the pixel; position and occlusion of all frames follow from that one point.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from decomotion.model.fusion import DecoMotion, PairConditioning, Rays
from decomotion.rays import lift

OBJECT_SHARE = 0.1
"""The dynamic volume owns a pixel where its share of the fused weight is above this: the blurred rim of an object goes
with the object (M45 in docs/research/model.md). Of a ray without weight that share is 0."""


@dataclass(frozen=True)
class Surface:
    """The visible surface at some pixels."""

    canonical: Float[Tensor, "batch point 3"]
    """In the canonical space of the volume that owns the pixel."""
    is_static: Tensor
    """[batch, point] bool: which volume that is."""


@dataclass(frozen=True)
class Answer:
    """Where points are and whether they are hidden. Axes: query, frame."""

    xy: Float[Tensor, "query frame 2"]
    """Pixels, inside or outside the image."""
    occlusion: Float[Tensor, "query frame"]
    """Score in [0, 1]; 0.5 where the cycle error is the configured scale."""


def surface_of(
    model: DecoMotion,
    xy: Float[Tensor, "batch point 2"],
    conditioning: PairConditioning,
    frame: Int[Tensor, " batch"] | None = None,
) -> Surface:
    """The surface that the rays through pixels `xy` meet, in the frames of `conditioning` (row by row, or row `frame`).

    The dynamic volume owns the pixel where its share of the fused weight is above `OBJECT_SHARE`, the static one
    elsewhere. Averaging over both volumes, as in training, would put points of an object's outline between the object
    and the scene.
    """
    rays = model.cast(xy, conditioning, frame)
    is_static = static_owns(rays.static_confidence)
    weights = torch.where(is_static[..., None], rays.fused_static, rays.fused_dynamic)
    return surface_on(model, rays, weights, is_static, conditioning, frame)


def surface_on(
    model: DecoMotion,
    rays: Rays,
    weights: Float[Tensor, "batch point sample"],
    is_static: Bool[Tensor, "batch point"],
    conditioning: PairConditioning,
    frame: Int[Tensor, " batch"] | None = None,
) -> Surface:
    """The surface on `rays` at the mean depth of their samples by `weights`, in the volume that `is_static` names.

    The ray's point at that depth is mapped to canonical space. Averaging the samples' canonical positions instead would
    leave the surface, since the map bends the ray.
    """
    depth = (weights * rays.depths).sum(-1) / weights.sum(-1).clamp_min(1e-6)
    points = lift(rays.xy, depth[..., None])[..., 0, :]
    u = model.static.to_canonical(points, conditioning.static, frame)
    v = model.dynamic.to_canonical(points, conditioning.dynamic, frame)
    return Surface(torch.where(is_static[..., None], u, v), is_static)


def static_owns(static_confidence: Float[Tensor, "*batch"]) -> Bool[Tensor, "*batch"]:
    """Whether the static volume owns pixels; a reader of the file says the same (`decomo_runtime`'s `on_object`)."""
    return static_confidence >= 1 - OBJECT_SHARE


def carry(
    model: DecoMotion,
    surface: Surface,
    conditioning: PairConditioning,
    frame: Int[Tensor, " batch"] | None = None,
) -> Float[Tensor, "batch point 2"]:
    """Pixels at which surface points lie in the frames of `conditioning` (row by row, or row `frame`)."""
    u = model.static.from_canonical(surface.canonical, conditioning.static, frame)
    v = model.dynamic.from_canonical(surface.canonical, conditioning.dynamic, frame)
    return model.plane.to_pixels(torch.where(surface.is_static[..., None], u, v)[..., :2])


def answer(
    model: DecoMotion,
    conditioning: PairConditioning,
    query_xy: Float[Tensor, "query 2"],
    query_frame: Int[Tensor, " query"],
    frames: Int[Tensor, " frame"],
) -> Answer:
    """Tracks of query points through `frames`.

    Occlusion is the model's own cycle error: the surface that is seen at the point's place in the target frame is
    carried back to the query's frame; it is the same point if it returns to where the query was. In its own frame a
    query is where it is, and visible. This is the definition; `decomo_export.graph` is the form that answers fast.

    Args:
        model: the fused model.
        conditioning: of all frames of the clip.
        query_xy: pixels.
        query_frame: the frame of each query.
        frames: the target frames.
    """
    surface = surface_of(model, query_xy[:, None], conditioning, query_frame)
    targets = PairConditioning(conditioning.static.take(frames), conditioning.dynamic.take(frames))
    shape = (frames.shape[0], query_xy.shape[0])  # not len(): it would fix the size that the exporter traces
    repeated = Surface(
        surface.canonical[:, 0].expand(*shape, 3),
        surface.is_static[:, 0].expand(shape),
    )
    at_home = frames[:, None] == query_frame
    there = torch.where(at_home[..., None], query_xy, carry(model, repeated, targets))

    plane = model.plane
    last = there.new_tensor([plane.width - 1.0, plane.height - 1.0])
    inside = torch.minimum(there.clamp_min(0.0), last)
    gone = ((there < -0.5) | (there > last + 0.5)).any(-1)
    seen = surface_of(model, inside, targets)
    swapped = Surface(seen.canonical.transpose(0, 1), seen.is_static.transpose(0, 1))
    back = carry(model, swapped, conditioning, query_frame).transpose(0, 1)
    error = (back - query_xy).norm(dim=-1) * (1 / plane.unit)
    occlusion = torch.where(gone, torch.ones_like(error), error / (error + model.config.occlusion_scale))
    occlusion = occlusion.masked_fill(at_home, 0.0)
    return Answer(there.transpose(0, 1), occlusion.transpose(0, 1))

"""Answers: where a query point is in other frames, and whether it is hidden there.

A query's ray is composited once. The point that is carried to the other frames is the surface that the ray meets, in
canonical space, of the volume that owns the pixel; position and occlusion of all frames follow from that one point.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from decomotion.compositing import composite
from decomotion.model.fusion import DecoMotion, PairConditioning, Rays


@dataclass(frozen=True)
class Surface:
    """The visible surface at some pixels: the points that stand for it, which are averaged where they are carried."""

    canonical: Float[Tensor, "batch point carried 3"]
    """In the canonical space of the volume that owns the pixel."""
    weights: Float[Tensor, "batch point carried"]
    """They sum to 1 over a pixel's points."""
    is_static: Tensor
    """[batch, point] bool: which volume that is."""


@dataclass(frozen=True)
class Answer:
    """Where points are and whether they are hidden. Axes: query, frame."""

    xy: Float[Tensor, "query frame 2"]
    """Pixels, inside or outside the image."""
    occlusion: Float[Tensor, "query frame"]
    """Score in [0, 1]; 0.5 where the cycle error is the configured scale."""


def surface_of(model: DecoMotion, rays: Rays) -> Surface:
    """The surface that each ray meets.

    The volume with the larger share of the fused weight owns the pixel; its samples are averaged by weight. Averaging
    over both volumes, as in training, would put points of an object's outline between the object and the scene.
    """
    is_static = rays.fused_static.sum(-1) >= rays.fused_dynamic.sum(-1)
    owner = is_static[..., None]
    canonical = torch.where(owner[..., None], rays.static_canonical, rays.dynamic_canonical)
    canonical, (weights,) = model.to_carry(canonical, torch.where(owner, rays.fused_static, rays.fused_dynamic))
    return Surface(canonical, weights / weights.sum(-1, keepdim=True).clamp_min(1e-6), is_static)


def carry(
    model: DecoMotion,
    surface: Surface,
    conditioning: PairConditioning,
    frame: Int[Tensor, " batch"] | None = None,
) -> Float[Tensor, "batch point 2"]:
    """Pixels at which surface points lie in the frames of `conditioning` (row by row, or row `frame`)."""
    shape = surface.canonical.shape
    points = surface.canonical.flatten(1, 2)
    u = model.static.from_canonical(points, conditioning.static, frame).reshape(shape)
    v = model.dynamic.from_canonical(points, conditioning.dynamic, frame).reshape(shape)
    owned = torch.where(surface.is_static[..., None, None], u, v)
    return model.plane.to_pixels(composite(surface.weights, owned)[..., :2])


def answer(
    model: DecoMotion,
    conditioning: PairConditioning,
    rays: Rays,
    query_xy: Float[Tensor, "query 2"],
    query_frame: Int[Tensor, " query"],
    frames: Int[Tensor, " frame"],
) -> Answer:
    """Tracks of query points through `frames`.

    Occlusion is the model's own cycle error: the surface that is seen at the point's place in the target frame is
    carried back to the query's frame; it is the same point if it returns to where the query was.

    Args:
        model: the fused model.
        conditioning: of all frames of the clip.
        rays: the queries' own rays, [query, 1, sample].
        query_xy: pixels.
        query_frame: the frame of each query.
        frames: the target frames.
    """
    surface = surface_of(model, rays)
    targets = PairConditioning(conditioning.static.take(frames), conditioning.dynamic.take(frames))
    shape = (frames.shape[0], query_xy.shape[0])  # not len(): it would fix the size that the exporter traces
    repeated = Surface(
        surface.canonical[:, 0].expand(*shape, *surface.canonical.shape[2:]),
        surface.weights[:, 0].expand(*shape, *surface.weights.shape[2:]),
        surface.is_static[:, 0].expand(shape),
    )
    there = carry(model, repeated, targets)

    plane = model.plane
    last = there.new_tensor([plane.width - 1.0, plane.height - 1.0])
    inside = torch.minimum(there.clamp_min(0.0), last)
    gone = ((there < -0.5) | (there > last + 0.5)).any(-1)
    seen = surface_of(model, model.cast(inside, targets))
    swapped = Surface(seen.canonical.transpose(0, 1), seen.weights.transpose(0, 1), seen.is_static.transpose(0, 1))
    back = carry(model, swapped, conditioning, query_frame).transpose(0, 1)
    error = (back - query_xy).norm(dim=-1) * (128 / plane.pixels_per_unit)
    occlusion = torch.where(gone, torch.ones_like(error), error / (error + model.config.occlusion_scale))
    return Answer(there.transpose(0, 1), occlusion.transpose(0, 1))

"""Orthographic rays: where on a pixel's ray the volumes are evaluated."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from decomotion.pseudo_depth import FAR, NEAR


def sample_depths(
    like: Float[Tensor, "*batch 2"], samples: int, offset: Float[Tensor, "*batch sample"] | None = None
) -> Float[Tensor, "*batch sample"]:
    """Pseudo-depths of the ray samples, ascending: one in each of `samples` equal bins of [NEAR, FAR].

    `offset` says where in its bin each lies, in [0, 1): drawn evenly in training (stratified); None: at the bins'
    centres.
    """
    bins = torch.arange(samples, dtype=like.dtype, device=like.device)
    if offset is None:
        offset = torch.full_like(like[..., :1], 0.5)
    return NEAR + (bins + offset) * ((FAR - NEAR) / samples)


def lift(xy: Float[Tensor, "*batch 2"], depths: Float[Tensor, "*batch sample"]) -> Float[Tensor, "*batch sample 3"]:
    """Local 3D points on the orthographic rays of normalised positions `xy` (x and y do not change along a ray)."""
    samples = depths.shape[-1]
    return torch.cat([xy[..., None, :].expand(*xy.shape[:-1], samples, 2), depths[..., None]], dim=-1)

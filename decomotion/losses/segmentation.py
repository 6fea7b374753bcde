"""Mask guidance of the static confidence (paper, Eq. 11)."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor


def segmentation_loss(
    motion_mask: Float[Tensor, "pair point"],
    moving: Float[Tensor, "pair point"],
    weight: Float[Tensor, "pair point"],
) -> Float[Tensor, ""]:
    """Weighted binary cross-entropy of the rendered mask B (1: static) and M (1: moving), averaged over all points."""
    still = motion_mask.clamp(1e-4, 1 - 1e-4)
    return -(weight * ((1 - moving) * torch.log(still) + moving * torch.log(1 - still))).mean()

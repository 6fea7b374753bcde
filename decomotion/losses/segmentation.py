"""Mask guidance of the static confidence (paper, Eq. 11)."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor


def segmentation_loss(
    static_confidence: Float[Tensor, "pair point"],
    moving: Float[Tensor, "pair point"],
    weight: Float[Tensor, "pair point"],
) -> Float[Tensor, ""]:
    """Weighted binary cross-entropy of static confidence and motion mask (1: moving), averaged over all points."""
    confidence = static_confidence.clamp(1e-4, 1 - 1e-4)
    return -(weight * ((1 - moving) * torch.log(confidence) + moving * torch.log(1 - confidence))).mean()

"""Mask guidance of the static confidence (paper, Eq. 12)."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor


def segmentation_loss(
    static_confidence: Float[Tensor, "pair point"], moving: Float[Tensor, "pair point"]
) -> Float[Tensor, ""]:
    """Binary cross-entropy between the rendered static confidence and the motion mask (1: moving)."""
    confidence = static_confidence.clamp(1e-4, 1 - 1e-4)
    return -((1 - moving) * torch.log(confidence) + moving * torch.log(1 - confidence)).mean()

"""Mask guidance of the fusion (paper, Eq. 11), and that it be opaque."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

SMALLEST = 1e-4
"""Is added to weights, which keeps the logarithm finite and its slope at a weight of 0 alive."""
OPACITY_SHARE = 0.1
"""How much a ray that no volume stops counts, beside one that the wrong volume stops."""


def segmentation_loss(
    static: Float[Tensor, "pair point"],
    dynamic: Float[Tensor, "pair point"],
    moving: Float[Tensor, "pair point"],
    weight: Float[Tensor, "pair point"],
) -> Float[Tensor, ""]:
    """Weighted cross-entropy of the volumes' shares and the motion mask (1: moving), averaged over all points.

    `static` and `dynamic` are each volume's total weight in the fused ray; they sum to its opacity. Their shares say
    nothing of rays that no volume stops, which are wrong whatever the mask says: `OPACITY_SHARE` -log(opacity) is
    added.
    """
    opacity = torch.log(static + dynamic + SMALLEST)
    static, dynamic = torch.log(static + SMALLEST) - opacity, torch.log(dynamic + SMALLEST) - opacity
    return -(weight * ((1 - moving) * static + moving * dynamic + OPACITY_SHARE * opacity)).mean()

"""Mask guidance of the fusion (paper, Eq. 11)."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

SMALLEST = 1e-4
"""Is added to weights, which keeps the logarithm finite and its slope at a weight of 0 alive."""


def segmentation_loss(
    static: Float[Tensor, "pair point"],
    dynamic: Float[Tensor, "pair point"],
    moving: Float[Tensor, "pair point"],
    weight: Float[Tensor, "pair point"],
) -> Float[Tensor, ""]:
    """Weighted cross-entropy of the volumes' fused weights and the motion mask (1: moving), averaged over all points.

    `static` and `dynamic` are each volume's total weight in the fused ray. They sum to its opacity, so the loss is
    that of the static share plus -log(opacity): a ray that no volume stops is wrong whatever the mask says.
    """
    static, dynamic = torch.log(static + SMALLEST), torch.log(dynamic + SMALLEST)
    return -(weight * ((1 - moving) * static + moving * dynamic)).mean()

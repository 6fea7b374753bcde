"""Colour rendering loss (paper, Eq. 7, 10 and 13)."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor


def photometric_loss(
    rendered: Float[Tensor, "pair point 3"], rgb: Float[Tensor, "pair point 3"], weight: Float[Tensor, "pair point"]
) -> Float[Tensor, ""]:
    """Weighted squared L2 distance of colours in [0, 1], averaged over all points."""
    return (weight * (rendered - rgb).square().sum(-1)).mean()

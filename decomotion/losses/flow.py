"""Motion rendering loss (paper, Eq. 6, 9 and 12)."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor


def flow_loss(
    predicted_xy: Float[Tensor, "pair point 2"],
    target_xy: Float[Tensor, "pair point 2"],
    weight: Float[Tensor, "pair point"],
) -> Float[Tensor, ""]:
    """Weighted L1 distance in units, averaged over all points, those of weight 0 included."""
    return (weight * (predicted_xy - target_xy).abs().sum(-1)).mean()

"""Feature rendering loss (paper, Eq. 8)."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor


def feature_loss(
    rendered: Float[Tensor, "pair point feature"],
    feature: Float[Tensor, "pair point feature"],
    weight: Float[Tensor, "pair point"],
) -> Float[Tensor, ""]:
    """Weighted L1 distance of features, averaged over channels and points; 0 where there are no channels."""
    if not feature.shape[-1]:
        return weight.new_zeros(())
    return (weight * (rendered - feature).abs().mean(-1)).mean()

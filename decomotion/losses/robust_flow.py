"""Motion loss for links of which some are wrong, or not a volume's to explain: what is far off hardly pulls."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

SCALE = 2.0
"""Distance in units at which the pull of a point has fallen to a half."""


def robust_flow_loss(
    predicted_xy: Float[Tensor, "pair point 2"],
    target_xy: Float[Tensor, "pair point 2"],
    weight: Float[Tensor, "pair point"],
) -> Float[Tensor, ""]:
    """Weighted SCALE log(1 + d / SCALE) of the distances d in units, averaged over all points, weight 0 included."""
    distance = (predicted_xy - target_xy).abs().sum(-1)
    return (weight * SCALE * torch.log1p(distance / SCALE)).mean()

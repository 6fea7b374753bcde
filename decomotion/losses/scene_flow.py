"""Scene-flow smoothness (Li et al. 2021, as OmniMotion uses it)."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor


def scene_flow_loss(acceleration: Float[Tensor, "pair smooth_point sample 3"]) -> Float[Tensor, ""]:
    """Mean L1 norm of x_{i-1} + x_{i+1} - 2 x_i, in normalised units; 0 where there are no points."""
    return acceleration.abs().sum() / max(1, acceleration[..., 0].numel())

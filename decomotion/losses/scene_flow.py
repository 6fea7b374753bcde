"""Scene-flow smoothness (Li et al. 2021, as OmniMotion uses it)."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor


def scene_flow_loss(acceleration: Float[Tensor, "pair point sample 3"]) -> Float[Tensor, ""]:
    """Mean L1 norm of x_{i-1} + x_{i+1} - 2 x_i, in normalised units: motion is smooth in time."""
    return acceleration.abs().sum(-1).mean()

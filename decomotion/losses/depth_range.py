"""Depth range: what is mapped to another frame stays within its volume (OmniMotion)."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor


def depth_range_loss(depths: Float[Tensor, "*batch sample"], near: float, far: float) -> Float[Tensor, ""]:
    """Mean squared distance of pseudo-depths from the interval [near, far]."""
    beyond = torch.relu(near - depths) + torch.relu(depths - far)
    return beyond.square().mean()

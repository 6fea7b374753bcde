"""Steepness: no layer shears by more than 45 degrees, so that a chain of them cannot amplify itself into chaos."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

LIMIT = 1.0
"""Slope from which it costs: a shift that changes by a unit over a unit of length."""


def steepness_loss(slopes: Float[Tensor, "*batch slope"]) -> Float[Tensor, ""]:
    """Mean squared excess of the slopes over the limit; 0 where there are none."""
    return torch.relu(slopes.abs() - LIMIT).square().sum() / max(1, slopes.numel())

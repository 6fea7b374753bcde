"""Distortion: weights gather on one surface (Barron et al. 2022, mip-NeRF 360, Eq. 15)."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor


def distortion_loss(
    weights: Float[Tensor, "*batch sample"], depths: Float[Tensor, "*batch sample"], near: float, far: float
) -> Float[Tensor, ""]:
    """sum_ab w_a w_b |s_a - s_b| + sum_a w_a^2 / (3 K), with depths s scaled to [0, 1] and bins of width 1/K.

    The double sum over ascending depths is a single one over cumulated sums.
    """
    s = (depths - near) / (far - near)
    in_front = torch.cumsum(weights, dim=-1) - weights
    moment_in_front = torch.cumsum(weights * s, dim=-1) - weights * s
    between = 2 * (weights * (s * in_front - moment_in_front)).sum(-1)
    within = weights.square().sum(-1) / (3 * weights.shape[-1])
    return (between + within).mean()

"""Alpha compositing along rays, for one volume and for the fusion of two.

Notation, on the axis `sample` that runs from near to far (paper, Eq. 2 and 5):
    sigma   density of a sample, non-negative
    alpha   1 - exp(-sigma), the opacity of a sample
    T       transmittance: the share of light that reaches a sample, exp(-sum of sigma in front of it)
    w       weight of a sample, T * alpha; the weights of a ray sum to at most 1, not to 1
    beta    static confidence of a sample in [0, 1]
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor


def transmittance(sigma: Float[Tensor, "*batch sample"]) -> Float[Tensor, "*batch sample"]:
    """T_k = exp(-sum_{l<k} sigma_l): exclusive of the sample itself."""
    return torch.exp(sigma - torch.cumsum(sigma, dim=-1))


def composite_weights(sigma: Float[Tensor, "*batch sample"]) -> Float[Tensor, "*batch sample"]:
    """w_k = T_k (1 - exp(-sigma_k)) of one volume (paper, Eq. 2)."""
    return transmittance(sigma) * -torch.expm1(-sigma)


class FusedWeights(NamedTuple):
    """Weights of the static and the dynamic sample at each depth; all of a ray's weights sum to at most 1."""

    static: Float[Tensor, "*batch sample"]
    dynamic: Float[Tensor, "*batch sample"]


def fused_weights(
    sigma_static: Float[Tensor, "*batch sample"],
    sigma_dynamic: Float[Tensor, "*batch sample"],
    beta: Float[Tensor, "*batch sample"],
) -> FusedWeights:
    """Weights of the fused volume (paper, Eq. 5).

    The combined density beta sigma_st + (1 - beta) sigma_dy attenuates; at each sample the static volume takes
    T beta alpha(sigma_st) and the dynamic one T (1 - beta) alpha(sigma_dy).
    """
    through = transmittance(beta * sigma_static + (1 - beta) * sigma_dynamic)
    return FusedWeights(
        through * beta * -torch.expm1(-sigma_static),
        through * (1 - beta) * -torch.expm1(-sigma_dynamic),
    )


def static_share(static: Float[Tensor, "*batch"], dynamic: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """The static confidence of rays, from both volumes' fused weights: the static one's share of them.

    It is 1 where a ray has no weight: where nothing is, nothing moves.
    """
    total = static + dynamic
    return torch.where(total > LEAST_WEIGHT, static / total.clamp_min(LEAST_WEIGHT), 1.0)


LEAST_WEIGHT = 1e-6
"""A ray of less fused weight has none."""


def composite(
    weights: Float[Tensor, "*batch sample"], values: Float[Tensor, "*batch sample channel"]
) -> Float[Tensor, "*batch channel"]:
    """Sum over the samples of weight times value."""
    return torch.matmul(weights[..., None, :], values)[..., 0, :]


def as_if_opaque(colour: Tensor, opacity: Tensor) -> Tensor:
    """The colour of one volume's rays for a picture: the mean of their samples' by weight, however thin the ray.

    The opacity broadcasts against the colour, whose channels are on any axis.
    """
    return colour / opacity.clamp_min(1e-3)


THIN, THICK = 0.25, 0.75
"""Opacities: below the first a ray is taken for one that no volume stops, above the second it is as it was fitted."""


def thickened(colour: Tensor, opacity: Tensor) -> Tensor:
    """The fused colour of rays for a picture: where a ray is thin, not dark but of the colour of what little there is.

    The colour is divided by o + (1 - o) s of the opacity o, where s rises from 0 at `THIN` to 1 at `THICK`. The opacity
    broadcasts against the colour, whose channels are on any axis.
    """
    share = ((opacity - THIN) / (THICK - THIN)).clamp(0.0, 1.0)
    return colour / (opacity + (1 - opacity) * share).clamp_min(1e-3)

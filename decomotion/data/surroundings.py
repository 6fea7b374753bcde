"""Where a point is expected whose target is not known: what is hidden moves as what it is a part of moves around it.

The motion of the links around is a similarity, fitted by moving least squares: each point has one of its own, to which
links count the more the nearer they begin (Schaefer, McPhail and Warren 2006, "Image deformation using moving least
squares"), and the less the farther they are from it (iteratively reweighted, Cauchy's weights).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

FEWEST = 8.0
"""Links around, by their confidence, from which a motion is told."""
REACH = 32.0
"""Units: what is known that far away tells a point's motion with a weight of 1 / e."""
NEAREST = 4.0
"""Units added to distances: links that begin nearer than this count about alike."""
DEVIATION = 2.0
"""Units by which a link may differ from the motion around before it counts half."""
ROUNDS = 3
"""Fits, each weighted by the former's deviations."""


class Expected(NamedTuple):
    """Of points whose target is not known."""

    xy: Float[Tensor, "pair point 2"]
    """Where they are expected, in units."""
    weight: Float[Tensor, "pair point"]
    """In [0, 1]: the share of the links around that move alike, less the farther they are; 0 where there are few."""


def expected(
    xy: Float[Tensor, "pair point 2"],
    known_xy: Float[Tensor, "pair known 2"],
    known_target: Float[Tensor, "pair known 2"],
    weight: Float[Tensor, "pair point known"],
) -> Expected:
    """Where points `xy` are expected in the target frame by known links. Positions in units.

    Args:
        xy: the points.
        known_xy: where links begin.
        known_target: where they end.
        weight: of each link for each point; 0 of those that are of another part.
    """
    apart = torch.cdist(xy, known_xy)
    near = weight / (apart + NEAREST) ** 2
    agreeing, moved = near, xy
    for _ in range(ROUNDS):
        moved, deviation = _moved(xy, known_xy, known_target, agreeing)
        agreeing = near / (1 + (deviation / DEVIATION) ** 2)
    agreement = agreeing.sum(-1) / near.sum(-1).clamp_min(1e-9)
    nearest = torch.where(weight > 0, apart, torch.inf).amin(-1)
    return Expected(moved, torch.where(weight.sum(-1) >= FEWEST, agreement * torch.exp(-nearest / REACH), 0.0))


def _moved(
    xy: Float[Tensor, "pair point 2"],
    known_xy: Float[Tensor, "pair known 2"],
    known_target: Float[Tensor, "pair known 2"],
    weight: Float[Tensor, "pair point known"],
) -> tuple[Float[Tensor, "pair point 2"], Float[Tensor, "pair point known"]]:
    """The points under each one's similarity, and by how much each link differs from that."""
    share = weight / weight.sum(-1, keepdim=True).clamp_min(1e-9)
    at, begin, end = (torch.view_as_complex(each.contiguous()) for each in (xy, known_xy, known_target))
    centre = (share * begin[:, None]).sum(-1, keepdim=True)
    its_end = (share * end[:, None]).sum(-1, keepdim=True)
    x, y = begin[:, None] - centre, end[:, None] - its_end
    # as if one more unit of spread had not turned: what begins at one place is shifted
    turn = (1 + (share * x.conj() * y).sum(-1, keepdim=True)) / (
        1 + (share * (x * x.conj()).real).sum(-1, keepdim=True)
    )
    moved = its_end[..., 0] + turn[..., 0] * (at - centre[..., 0])
    return torch.view_as_real(moved), (y - turn * x).abs()

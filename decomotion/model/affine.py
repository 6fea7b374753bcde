"""The camera part of a transform: one 3D affine map per frame (paper, A_theta)."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn


def inverse_3x3(matrix: Float[Tensor, "*batch 3 3"]) -> Float[Tensor, "*batch 3 3"]:
    """Closed-form inverse through the adjugate, in operations that every ONNX runtime has."""
    a, b, c = matrix.unbind(-2)
    cofactors = torch.stack([torch.linalg.cross(b, c), torch.linalg.cross(c, a), torch.linalg.cross(a, b)], dim=-1)
    determinant = (a * torch.linalg.cross(b, c)).sum(-1)
    return cofactors / determinant[..., None, None]


class AffineTransform(nn.Module):
    """x -> A_i x + b_i, the start's map plus a correction that a 2-layer MLP predicts from the frame's code.

    Args:
        code_size: length of the frame code.
        hidden: width of the MLP's hidden layer.
        start: [frame, 3, 4], the maps (A | b) from local to canonical space that training begins with.
    """

    start: Tensor

    def __init__(self, code_size: int, hidden: int, start: Float[Tensor, "frame 3 4"]) -> None:
        super().__init__()
        self.register_buffer("start", start)
        self.hidden = hidden
        self.correction = nn.Sequential(nn.Linear(code_size, hidden), nn.ReLU(), nn.Linear(hidden, 12))
        last = self.correction[2]
        assert isinstance(last, nn.Linear)
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)

    def condition(self, code: Float[Tensor, "all code"]) -> Float[Tensor, "all 3 8"]:
        """For every frame of the clip `(A | b | A^-1 | -A^-1 b)`, each map ready to apply."""
        # a step of Adam moves every weight of the last layer: divided, the sum moves as far as one of them
        forward = self.start + (self.correction(code) / self.hidden).unflatten(-1, (3, 4))
        matrix, offset = forward[..., :3], forward[..., 3:]
        inverse = inverse_3x3(matrix)
        return torch.cat([matrix, offset, inverse, -inverse @ offset], dim=-1)

    @staticmethod
    def to_canonical(
        points: Float[Tensor, "batch point 3"], maps: Float[Tensor, "batch 3 8"]
    ) -> Float[Tensor, "batch point 3"]:
        """A x + b with the maps of `condition`, one row a batch row."""
        return points @ maps[..., :3].transpose(-1, -2) + maps[:, None, :, 3]

    @staticmethod
    def from_canonical(
        points: Float[Tensor, "batch point 3"], maps: Float[Tensor, "batch 3 8"]
    ) -> Float[Tensor, "batch point 3"]:
        """A^-1 (x - b)."""
        return points @ maps[..., 4:7].transpose(-1, -2) + maps[:, None, :, 7]

"""Mixed precision: the products of wide hidden layers in bfloat16, all else in float32.

bfloat16 has eight significant bits: fine for a hidden layer, whose errors average out, but a position rounded to it
is off by up to half a pixel in 256. Positions, encodings, filters, densities, weights along rays and the layers that
put them out therefore stay in float32; what is left, products of square layers, is nearly all of the arithmetic.
"""

from __future__ import annotations

from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn

DTYPES = {"none": None, "bf16": torch.bfloat16}


class HiddenLinear(nn.Linear):
    """A linear layer between hidden layers, in float32 unless `set_precision` says otherwise."""

    reduced: torch.dtype | None = None

    def forward(self, input: Float[Tensor, "*batch channel"]) -> Float[Tensor, "*batch other"]:
        """W x + b, in the reduced type where there is one; the next layer's input need not be cast back."""
        if self.reduced is None:
            return super().forward(input)
        with torch.autocast(input.device.type, self.reduced):
            return super().forward(input)


def set_precision(model: nn.Module, autocast: Literal["none", "bf16"]) -> None:
    """Chooses the precision of all hidden layers of `model`; their weights stay in float32."""
    for module in model.modules():
        if isinstance(module, HiddenLinear):
            module.reduced = DTYPES[autocast]

"""Mixed precision: which layers it is of."""

from __future__ import annotations

import torch
from torch import nn

from decomotion.model.precision import HiddenLinear, set_precision


def test_products_of_hidden_layers_alone_are_reduced():
    torch.manual_seed(0)
    model = nn.ModuleDict({"in": nn.Linear(3, 8), "deeper": nn.Sequential(HiddenLinear(8, 8), HiddenLinear(8, 8))})
    x = torch.rand(5, 3)
    whole = model["deeper"](model["in"](x))
    set_precision(model, "bf16")
    assert model["in"](x).dtype == torch.float32
    reduced = model["deeper"](model["in"](x))
    assert reduced.dtype == torch.bfloat16
    assert {parameter.dtype for parameter in model.parameters()} == {torch.float32}
    # eight significant bits
    torch.testing.assert_close(reduced.float(), whole, rtol=0.02, atol=0.02)
    set_precision(model, "none")
    assert torch.equal(model["deeper"](model["in"](x)), whole)

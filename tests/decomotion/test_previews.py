"""Preview pictures."""

from __future__ import annotations

import numpy as np
import pytest

from decomotion.previews import render_layers
from tiny_fit import tiny_model


@pytest.mark.parametrize(("height", "width", "side", "shape"), [(24, 32, 128, (24, 160)), (24, 32, 16, (12, 80))])
@pytest.mark.parametrize("preset", ["cpu", "paper"])
def test_five_layers_side_by_side(preset: str, height: int, width: int, side: int, shape: tuple[int, int]):
    picture = render_layers(tiny_model(preset, height=height, width=width), 2, side)
    assert picture.shape == (*shape, 3)
    assert picture.dtype == np.uint8

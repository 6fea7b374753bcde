"""Preview pictures."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from decomotion.previews import render_layers, to_png
from tiny_fit import tiny_model


@pytest.mark.parametrize(("height", "width", "side", "shape"), [(24, 32, 128, (24, 160)), (24, 32, 16, (12, 80))])
@pytest.mark.parametrize("preset", ["cpu", "paper"])
def test_five_layers_side_by_side(preset: str, height: int, width: int, side: int, shape: tuple[int, int]):
    picture = render_layers(tiny_model(preset, height=height, width=width), 2, side)
    assert picture.shape == (*shape, 3)
    assert picture.dtype == np.uint8


def test_png_is_lossless_rgb():
    picture = np.random.default_rng(0).integers(0, 256, (5, 7, 3), dtype=np.uint8)
    decoded = cv2.imdecode(np.frombuffer(to_png(picture), np.uint8), cv2.IMREAD_COLOR)
    assert decoded is not None
    np.testing.assert_array_equal(cv2.cvtColor(decoded, cv2.COLOR_BGR2RGB), picture)

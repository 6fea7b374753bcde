"""Measured values as colours: what is at which place."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from decomo_runtime.measure import picture as picture_module
from decomo_runtime.measure.picture import FOOTER, Chart, Colours
from decomo_runtime.measure.units import Scale

HEIGHT, WIDTH, FACTOR = 40, 64, 8


def test_a_disc_has_the_colour_of_its_value_and_what_is_no_value_has_none():
    colours = Colours("speed", "px/s", 2.0, signed=False)
    places = np.array([[10, 8], [30, 8], [50, 8], [30, 30], [np.nan, 30]])
    values = np.array([0.0, 1.0, 2.0, np.nan, 1.0])
    hidden = np.array([False, False, True, False, False])
    black = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    drawn = Chart(colours, (HEIGHT, WIDTH), Scale(), 1.0).points(black, places, values, hidden, 8.0)
    assert drawn.shape == (HEIGHT * FACTOR + FOOTER, WIDTH * FACTOR, 3)
    centres = np.rint((places[:4] + 0.5) * FACTOR - 0.5).astype(int)
    inks = [drawn[y, x].tolist() for x, y in centres]
    assert inks == [colours.of(np.array(0.0)).tolist(), colours.of(np.array(1.0)).tolist(), [0] * 3, [0] * 3]
    ring = drawn[centres[2, 1], centres[2, 0] : centres[2, 0] + 8]
    assert not ring[0].any()
    assert ring.any()


@pytest.mark.parametrize(("signed", "make"), [(False, "applyColorMap"), (True, None)])
def test_the_table_of_colours_is_made_once(signed: bool, make: str | None, monkeypatch: pytest.MonkeyPatch):
    made = []
    module, name = (picture_module.cv2, make) if make else (picture_module.np, "interp")
    original = getattr(module, name)

    def counted(*given: Any) -> Any:
        made.append(name)
        return original(*given)

    monkeypatch.setattr(module, name, counted)
    colours = Colours("strain", "1", 0.1, signed)
    chart = Chart(colours, (HEIGHT, WIDTH), Scale(), 1.0)
    many = np.random.default_rng(0).random((200, 2)) * 30
    for _ in range(3):
        chart.points(np.zeros((HEIGHT, WIDTH, 3), np.uint8), many, many[:, 0] / 300, many[:, 0] > 20, 4.0)
    assert len(made) == (3 if signed else 1)

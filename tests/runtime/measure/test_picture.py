"""Colours of what is measured, and the bar of lengths, by numbers that can be worked out by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from decomo_runtime import Scale
from decomo_runtime.measure import picture as picture_module
from decomo_runtime.measure.picture import FOOTER, Chart, Colours, _round_length, limit_of

HEIGHT, WIDTH = 90, 160
FACTOR = 4
"""Pixels of the canvas, of which the longer side has 512 at least, for one of the clip."""
GREY = np.full((HEIGHT, WIDTH, 3), 100, np.uint8)
BLUE, RED = (33, 102, 172), (178, 24, 43)


def chart(signed: bool = True, scale: Scale = Scale(0.5, "mm"), aspect: float = 1.0) -> Chart:  # noqa: B008
    return Chart(Colours("strain", "1", 2.0, signed), (HEIGHT, WIDTH), scale, aspect)


def test_98_percent_of_what_is_in_sight_is_within_the_limit():
    """Of 0 to 100, of both signs: 98, of two digits. What is hidden, or not known, does not count."""
    values = np.arange(101.0) * np.where(np.arange(101) % 2, -1, 1)
    hidden = np.zeros(101, bool)
    assert limit_of(values, hidden) == 98
    assert limit_of(values / 1000 + np.where(np.arange(101) == 40, np.nan, 0), hidden) == 0.098
    hidden[51:] = True
    assert limit_of(values, hidden) == 49
    assert limit_of(0 * values, hidden) == limit_of(values, ~hidden | hidden) == 1


def test_signs_have_colours_of_their_own():
    colours = Colours("strain", "1", 2.0, signed=True)
    given = colours.of(np.array([-2.0, -9.0, 0.0, 1.0, 2.0, 9.0]))
    assert [tuple(each) for each in given[[0, 1, 4, 5]].tolist()] == [BLUE, BLUE, RED, RED]
    assert given[2].min() > 240
    np.testing.assert_allclose(given[3], [244, 165, 130], atol=2)


def test_what_has_no_sign_runs_along_viridis():
    given = Colours("speed", "mm/s", 3.0, signed=False).of(np.array([0.0, 1.5, 3.0, 4.0]))
    np.testing.assert_allclose(given, [(68, 1, 84), (33, 145, 140), (253, 231, 37), (253, 231, 37)], atol=4)


@pytest.mark.parametrize(
    ("most", "length"),
    [(0.9, 0.5), (1.0, 1.0), (4.9, 2.0), (5.0, 5.0), (0.02, 0.02), (730, 500), (0.2 * 750 * (0.002 / 3), 0.1)],
)
def test_a_round_length_is_no_longer(most: float, length: float):
    assert _round_length(most) == pytest.approx(length)


@pytest.mark.parametrize(("aspect", "length"), [(1.0, 10.0), (1.5, 20.0)])
def test_the_bar_of_lengths_is_as_long_as_it_says(aspect: float, length: float):
    """The frame is 80 mm wide, or 120: the bar has a fifth of that at most, and 10 mm or 20 are 1 or 2 of 8 or 12."""
    picture = chart(aspect=aspect).points(GREY, np.empty((0, 2)), np.empty(0), np.empty(0, bool), 4)
    assert picture.shape == (HEIGHT * FACTOR + FOOTER, WIDTH * FACTOR, 3)
    bar = picture[HEIGHT * FACTOR + 20, : WIDTH * FACTOR * 2 // 5]
    lit = np.flatnonzero((bar > 200).all(-1))
    assert np.ptp(lit) == pytest.approx(WIDTH * FACTOR * length / (WIDTH * 0.5 * aspect), abs=4)


def test_points_are_discs_and_hidden_ones_rings():
    places = np.array([[20.0, 30.0], [90.0, 60.0], [np.nan, 3.0], [120.0, 20.0]])
    values, hidden = np.array([2.0, -2.0, 2.0, np.nan]), np.array([False, True, False, False])
    picture = chart().points(GREY, places, values, hidden, 8)
    middle = {tuple(place): picture[int(FACTOR * place[1]) + 1, int(FACTOR * place[0]) + 1] for place in places[:2]}
    assert middle[20.0, 30.0].tolist() == list(RED)
    assert middle[90.0, 60.0].tolist() == [100] * 3
    around = picture[200:290, 320:410].reshape(-1, 3)
    assert (np.abs(around.astype(int) - BLUE).max(axis=1) < 30).sum() > 20
    unknown = picture[40:130, 440:530]
    assert (unknown == 100).all()


def test_cells_are_drawn_between_what_is_known_of_one_thing():
    """Of three by four nodes one is hidden, and the last column is of something else: two cells of six are left."""
    x, y = np.meshgrid(np.arange(4) * 20 + 30, np.arange(3) * 20 + 20)
    places, values = np.stack([x, y], axis=-1).astype(float), np.full((3, 4), 2.0)
    hidden, groups = np.zeros((3, 4), bool), np.zeros((3, 4), bool)
    hidden[0, 0], groups[:, 3] = True, True
    values[2, 1] = np.nan
    picture = chart().cells(GREY, places, values, hidden, groups)
    mixed = np.round(0.7 * np.array(RED) + 30)
    drawn = [
        [np.abs(picture[4 * (30 + 20 * row), 4 * (40 + 20 * column)] - mixed).max() < 3 for column in range(3)]
        for row in range(2)
    ]
    assert drawn == [[False, True, False], [False, False, False]]
    assert picture[4 * 30, 4 * 40].tolist() == [100] * 3


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

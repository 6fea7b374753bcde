"""Points that come back: what is taken for one has to lead back to where it was hidden."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from decomo_runtime.model_file import ModelFacts
from decomo_runtime.queries import grid_queries
from decomo_runtime.returning import Returning

HEIGHT, WIDTH, FRAMES = 60, 90, 10
BEGIN, SHARED = 30, 34
GRID_STEP = 4 * WIDTH / 256


class Spreading:
    """In the shared frame all is three times as far from the corner as in any other, and hidden."""

    facts = ModelFacts("part", FRAMES, HEIGHT, WIDTH, 25.0, "cpu", 0.5)

    def track(self, queries: Any, frames: Any) -> Any:
        assert frames.tolist() == [SHARED - BEGIN]
        return 3 * queries[:, None, 1:], np.ones((len(queries), 1), np.float32)

    def sample(self, queries: Any) -> Any:
        return SimpleNamespace(on_object=lambda _: np.zeros(len(queries), bool))


@pytest.mark.parametrize(("away", "expected"), [(0.0, True), (0.3, True), (0.4, False), (2.0, False), (2.2, False)])
def test_what_is_found_leads_back_to_the_place(away: float, expected: bool):
    """A guess `away` from its neighbour, in pixels, is off by twice as much; 2 units are 0.7 pixels, 6 are 2.1."""
    model: Any = Spreading()
    places = 3 * grid_queries(GRID_STEP, 0, HEIGHT, WIDTH)[:, 1:]
    inside = (places[:, 0] < WIDTH - 5) & (places[:, 1] < HEIGHT - 5)
    xy = (places[inside] + (0, away)).astype(np.float32)
    found, queries = Returning(lambda: model, BEGIN, SHARED).find(xy, np.zeros(len(xy), bool))
    assert len(xy) > 100
    assert (found == expected).all()
    if expected:
        np.testing.assert_allclose(queries[:, 1:], xy - 2 / 3 * places[inside], atol=1e-3)
        assert set(queries[:, 0]) <= {BEGIN, BEGIN + 8}  # every fourth frame, but the shared one


class Standing(Spreading):
    """Nothing moves, and all is hidden in the shared frame: 280,000 points of 400 frames."""

    facts = ModelFacts("part", 400, HEIGHT, WIDTH, 25.0, "cpu", 0.5)

    def track(self, queries: Any, frames: Any) -> Any:
        return queries[:, None, 1:], np.ones((len(queries), 1), np.float32)


def test_a_long_window_has_any_number_of_hidden_points():
    model: Any = Standing()
    xy = np.array([[44.0, 30.0], [3.0, 57.0]], np.float32)
    found, queries = Returning(lambda: model, BEGIN, SHARED).find(xy, np.zeros(2, bool))
    assert found.all()
    np.testing.assert_allclose(queries[:, 1:], xy)


class Remembering(Standing):
    """Nothing moves; what is left of x = 45 is hidden in the shared frame, and what is left of 20 is an object.

    Asked again it says that all is hidden by the score `later`.
    """

    facts = ModelFacts("part", FRAMES, HEIGHT, WIDTH, 25.0, "cpu", 0.5)

    def __init__(self, later: float = 1.0) -> None:
        self.later, self.asked = later, 0

    def track(self, queries: Any, frames: Any) -> Any:
        assert (queries[:, 1:] >= -0.5).all()
        assert (queries[:, 1:] <= (WIDTH - 0.5, HEIGHT - 0.5)).all()
        self.asked += 1
        hidden = queries[:, 1] < 45 if self.asked == 1 else np.full(len(queries), self.later)
        return queries[:, None, 1:], hidden[:, None].astype(np.float32)

    def sample(self, queries: Any) -> Any:
        return SimpleNamespace(on_object=lambda _: queries[:, 1] < 20)


def asked_at(model: Any, *places: tuple[float, float], on_object: bool = False) -> list[bool]:
    xy = np.array(places, np.float32)
    found, _ = Returning(lambda: model, BEGIN, SHARED).find(xy, np.full(len(xy), on_object))
    return found.tolist()


def test_a_neighbour_is_hidden_within_six_units():
    """Which are 2.1 pixels."""
    last = max(grid_queries(GRID_STEP, 0, HEIGHT, WIDTH)[:, 1], key=lambda x: x * (x < 45))
    row = grid_queries(GRID_STEP, 0, HEIGHT, WIDTH)[0, 2]
    assert asked_at(Remembering(), (last, row), (last + 2.0, row), (last + 2.2, row)) == [True, True, False]


@pytest.mark.parametrize(("score", "found"), [(0.6, True), (0.4, False)])
def test_what_is_found_must_be_hidden_there(score: float, found: bool):
    assert asked_at(Remembering(score), (30.0, 30.0)) == [found]


def test_neighbours_are_of_the_same_owner():
    assert asked_at(Remembering(), (10.0, 30.0), (30.0, 30.0), on_object=True) == [True, False]
    assert asked_at(Remembering(), (10.0, 30.0), (30.0, 30.0)) == [False, True]


def test_beyond_the_border_nothing_is_asked():
    """A point hidden a pixel beyond it is taken for one on it, which is farther away than two units, 0.7 pixels."""
    assert asked_at(Remembering(), (-1.0, 30.0), (-1.5, 30.0), on_object=True) == [True, False]


@pytest.mark.parametrize(("shared", "frames"), [(34, {0, 8}), (35, {1, 9}), (32, {6})])
def test_points_are_picked_in_every_fourth_frame_but_the_shared_one(shared: int, frames: set[int]):
    class Noting(Standing):
        facts = Remembering.facts

        def track(self, queries: Any, numbers: Any) -> Any:
            asked.append(set(queries[:, 0].tolist()))
            assert numbers.tolist() == [shared - BEGIN]
            return super().track(queries, numbers)

    asked: list[set[float]] = []
    model: Any = Noting()
    found, queries = Returning(lambda: model, BEGIN, shared).find(np.float32([[44, 30]]), np.zeros(1, bool))
    assert found.all()
    assert asked[0] == frames
    assert queries[0, 0] - BEGIN in frames

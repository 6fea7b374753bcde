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

"""The rules of the filter, one by one, and together on links whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest

from decomotion.config import load
from decomotion.data.links.config import FilterConfig
from decomotion.data.links.filtering import (
    Grid,
    appearance_consistent,
    confirmed_by_second_look,
    cycle_consistent,
    filtered,
    follow,
)
from decomotion.data.pool import grid_shape, jittered_grid

SIDE, COUNT = 256, 4096
"""A frame in which a unit is a pixel."""


def rules(**changes: float | None) -> FilterConfig:
    return load("cpu").data.filters.model_copy(update=changes)


def test_a_cycle_is_consistent_below_the_threshold():
    xy = np.zeros((3, 2), np.float32)
    returned = np.array([[0.6, 0.7], [1, 0], [3, 4]], np.float32)
    np.testing.assert_array_equal(cycle_consistent(xy, returned, 1.0), [True, False, False])


def test_features_are_compared_by_their_cosine():
    here = np.array([[1, 0], [1, 0], [0, 0]], np.float16)
    there = np.array([[0.8, 0.6], [0.6, 0.8], [1, 0]], np.float16)
    np.testing.assert_array_equal(appearance_consistent(here, there, 0.7), [True, False, False])


@pytest.mark.parametrize(
    ("returned", "there_again", "confirmed"),
    [
        ((10, 0), (50, 0), True),  # misses by 10, and its end leads to the same place
        ((10, 0), (54, 0), False),  # its end leads elsewhere
        ((4, 0), (50, 0), False),  # misses by less than 1.5 thresholds: not hidden
    ],
)
def test_the_second_look(returned: tuple[float, float], there_again: tuple[float, float], confirmed: bool):
    at = (np.array([each], np.float32) for each in ((0, 0), (50, 0), returned, there_again))
    np.testing.assert_array_equal(confirmed_by_second_look(*at, threshold=3.0), [confirmed])


class TestGrid:
    @pytest.mark.parametrize(("height", "width"), [(48, 64), (33, 57)])
    def test_a_point_is_nearest_to_itself(self, height: int, width: int):
        grid = Grid(*grid_shape(height, width, 100), height, width)
        points = jittered_grid(1, height, width, 100, np.random.default_rng(0))[0]
        found = grid.nearest(points)
        # jitter may put a point of an outermost cell onto the cell's border
        assert (found == np.arange(len(points))).mean() > 0.97

    def test_outside_it_is_the_outermost_cell(self):
        grid = Grid(2, 3, 20, 30)
        np.testing.assert_array_equal(grid.nearest(np.array([[-9.0, -9], [99, 99]], np.float32)), [0, 5])
        np.testing.assert_array_equal(grid.inside(np.array([[-0.5, 19.5], [29.6, 3]], np.float32)), [True, False])

    def test_links_are_followed_as_shifts(self):
        points, targets = np.array([[4.0, 4]], np.float32), np.array([[7.0, 5]], np.float32)
        np.testing.assert_allclose(follow(np.array([[5.0, 3]], np.float32), points, targets, np.array([0])), [[8, 4]])


class Scene:
    """Two frames: all goes right by 24 pixels, but for a disc in front, which stands still."""

    def __init__(self) -> None:
        self.grid = Grid(*grid_shape(SIDE, SIDE, COUNT), SIDE, SIDE)
        self.points = jittered_grid(2, SIDE, SIDE, COUNT, np.random.default_rng(0))
        on_disc = [self.on_disc(xy) for xy in self.points]
        shifts = np.array([24.0, 0], np.float32)
        there = [
            np.where(on[:, None], xy, xy + sign * shifts)
            for on, xy, sign in zip(on_disc, self.points, (1, -1), strict=True)
        ]
        self.targets = np.stack([[self.points[0], there[0]], [there[1], self.points[1]]]).astype(np.float32)
        self.confidence = np.full((2, 2, len(self.points[0])), 200, np.uint8)
        self.feature = np.stack([np.stack([on, ~on], axis=-1) for on in on_disc]).astype(np.float16)
        self.covered = ~on_disc[0] & self.on_disc(there[0])
        """Points of the first frame that the disc hides in the second."""

    def on_disc(self, xy: np.ndarray) -> np.ndarray:
        return np.linalg.norm(xy - 128, axis=-1) < 60

    def filtered(self, config: FilterConfig) -> np.ndarray:
        return filtered((0, 1), self.points, self.targets, self.confidence, self.feature, self.grid, config)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene()


def test_no_rule_changes_nothing(scene: Scene):
    np.testing.assert_array_equal(scene.filtered(rules()), 200)


@pytest.mark.parametrize(
    "config", [rules(cycle=3.0), rules(appearance=0.5, appearance_gap=1)], ids=["cycle", "appearance"]
)
def test_what_is_covered_goes(scene: Scene, config: FilterConfig):
    kept = scene.filtered(config) > 0
    assert scene.covered.sum() > 20
    assert kept[scene.covered].mean() < 0.1
    assert kept[~scene.covered].mean() > 0.95  # but for points next to the outline


def test_appearance_looks_at_long_gaps_only(scene: Scene):
    np.testing.assert_array_equal(scene.filtered(rules(appearance=0.5, appearance_gap=2)), 200)


def test_a_second_look_keeps_what_is_covered_and_consistent(scene: Scene):
    """The disc stands still: from where the way back ends, on the disc, the way there leads to the same place."""
    result = scene.filtered(rules(cycle=3.0, second_look=0.2))
    assert (result[scene.covered] == 51).mean() > 0.8
    assert (result[~scene.covered] == 200).mean() > 0.9


@pytest.mark.parametrize(("height", "width", "times"), [(576, 1024, 4), (144, 81, 0.5625), (256, 144, 1)])
@pytest.mark.parametrize(
    "config",
    [
        rules(cycle=3.0),
        rules(second_look=0.2),
        rules(cycle=1.5, second_look=0.2),
        rules(cycle=3.0, second_look=0.4, appearance=0.5, appearance_gap=1),
    ],
    ids=["cycle", "second look", "both", "all"],
)
def test_the_same_links_at_another_size(config: FilterConfig, height: int, width: int, times: float):
    """Lengths are in units: links of a frame of 256 pixels keep their confidence at any other size, lying too."""
    random = np.random.default_rng(1)
    frame = (256, 144) if height > width else (144, 256)
    points = jittered_grid(2, *frame, 900, random)
    shape = grid_shape(*frame, 900)
    there = (
        points[:, None]
        + random.normal(0, 2, (2, 2, *points.shape[1:]))
        + [[[[0, 0]], [[20, 5]]], [[[-20, -5]], [[0, 0]]]]
    )
    feature = random.normal(0, 1, (*points.shape[:2], 3))
    feature = (feature / np.linalg.norm(feature, axis=-1, keepdims=True)).astype(np.float16)
    confidence = np.where(random.random((2, 2, points.shape[1])) < 0.5, 200, 0).astype(np.uint8)

    def result(height: int, width: int, times: float) -> np.ndarray:
        placed, led = (((xy + 0.5) * times - 0.5).astype(np.float32) for xy in (points, there))
        return filtered((0, 1), placed, led, confidence, feature, Grid(*shape, height, width), config)

    expected, found = result(*frame, 1.0), result(height, width, times)
    assert len(np.unique(expected)) > 1
    assert (found == expected).mean() > 0.995  # but for what float32 puts into another cell

"""Of all pairs of annotated frames that which parts the most, by a plain twin."""

from __future__ import annotations

import time
from itertools import combinations

import numpy as np
import pytest

from decomo_runtime.propagation.disagreement import of_points, of_regions


def pair_by_pair_of_regions(said: np.ndarray, in_sight: np.ndarray, least: int):
    found = None
    for one, other in combinations(range(len(said)), 2):
        both = in_sight[one] & in_sight[other]
        first, second = said[one][both], said[other][both]
        either = (first | second).sum()
        if either >= least and (found is None or 1 - (first & second).sum() / either > found[0]):
            found = float(1 - (first & second).sum() / either), (one, other)
    return found


def pair_by_pair_of_points(xy: np.ndarray, hidden: np.ndarray):
    length = xy.shape[2]
    most, between = np.full(length, np.nan), np.full((length, 2), -1)
    for frame in range(length):
        for one, other in combinations(range(len(xy)), 2):
            apart = [
                np.linalg.norm(xy[one, point, frame] - xy[other, point, frame])
                for point in range(xy.shape[1])
                if not (hidden[one, point, frame] or hidden[other, point, frame])
                and np.isfinite(xy[[one, other], point, frame]).all()
            ]
            if apart and not np.mean(apart) <= most[frame]:
                most[frame], between[frame] = np.mean(apart), (one, other)
    return most, between


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("count", [2, 3, 7])
def test_regions_as_pair_by_pair(seed: int, count: int):
    chance = np.random.default_rng(seed)
    said, in_sight = chance.random((2, count, 41)) < chance.random((2, count, 1))
    assert of_regions(said, in_sight, 5) == pair_by_pair_of_regions(said, in_sight, 5)


def test_regions_that_no_two_have_in_sight():
    in_sight = np.eye(3, 30, dtype=bool)
    assert of_regions(np.ones((3, 30), bool), in_sight, 1) is None


def test_regions_that_agree_part_by_nothing():
    assert of_regions(np.ones((3, 30), bool), np.ones((3, 30), bool), 16) == (0.0, (0, 1))


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("count", [1, 2, 6])
def test_points_as_pair_by_pair(seed: int, count: int):
    chance = np.random.default_rng(seed)
    xy, hidden = chance.normal(size=(count, 3, 5, 2)), chance.random((count, 3, 5)) < 0.5
    xy[chance.random((count, 3, 5)) < 0.2] = np.nan
    apart, between = of_points(xy, hidden)
    wanted, pairs = pair_by_pair_of_points(xy, hidden)
    np.testing.assert_allclose(apart, wanted, rtol=1e-12)  # of sums in another order
    np.testing.assert_array_equal(between, pairs)


def test_very_many_annotated_frames():
    """Half a million pairs, which one by one take twice as long on a free machine."""
    said = np.random.default_rng(0).random((1000, 600)) < 0.5
    begin = time.process_time()
    assert of_regions(said, np.ones_like(said), 16) is not None
    assert time.process_time() - begin < 10

"""The two sides of pairs of frames that disagree about what moves."""

from __future__ import annotations

import numpy as np
import pytest

from decomotion.data.masks import agreement
from decomotion.data.masks.agreement import Agreement

POINTS = 200
BORDER = np.arange(POINTS) < 60
OBJECT = (np.arange(POINTS) >= 150) & (np.arange(POINTS) < 190)


def residuals(follows_object: bool, seen: np.ndarray | None = None) -> np.ndarray:
    values = np.where(follows_object != OBJECT, 8.0, 0.2).astype(np.float32)
    if seen is not None:
        values[~seen] = np.nan
    return values


def of_pairs(wrong: set[tuple[int, int]], frames: int = 9, reach: int = 3) -> dict[tuple[int, int], float]:
    found = Agreement()
    for frame in range(frames):
        others = [other for other in range(frame - reach, frame + reach + 1) if 0 <= other < frames and other != frame]
        told = {other: residuals((min(frame, other), max(frame, other)) in wrong) for other in others}
        found.add(frame, told, BORDER)
    return found.of_pairs(np.full(frames, 2.0, np.float32))


def test_where_all_agree_all_follow_the_scene():
    sides = of_pairs(set())
    assert len(sides) == 8 + 7 + 6
    np.testing.assert_allclose(list(sides.values()), 1, atol=1e-6)


@pytest.mark.parametrize(
    "wrong",
    [{(2, 5)}, {(3, 4), (4, 5), (3, 5), (2, 4), (4, 6)}, {(a, b) for a in range(4, 9) for b in range(a + 1, 9)}],
)
def test_pairs_that_follow_an_object_are_told_from_the_others(wrong: set[tuple[int, int]]):
    """One pair, one frame's, or all of the second half of the clip."""
    sides = of_pairs(wrong)
    assert {pair for pair, side in sides.items() if side < 0} == wrong & set(sides)
    assert {pair for pair, side in sides.items() if side > 0.5} == set(sides) - wrong


def test_parts_that_share_no_frame_are_on_one_side():
    """Each with a pair that is wrong."""
    found = Agreement()
    for frame in (0, 1, 2, 3, 10, 11, 12, 13):
        others = [other for other in range(frame // 10 * 10, frame // 10 * 10 + 4) if other != frame]
        told = {other: residuals({frame, other} in ({0, 3}, {11, 12})) for other in others}
        found.add(frame, told, BORDER)
    sides = found.of_pairs(np.full(14, 2.0, np.float32))
    assert {pair for pair, side in sides.items() if side < 0} == {(0, 3), (11, 12)}
    assert min(side for side in sides.values() if side > 0) > 0.5


def test_residuals_without_bound_are_large():
    found, huge = Agreement(), np.full(POINTS, np.inf, np.float32)
    found.add(0, {1: residuals(False), 2: huge}, BORDER)
    assert found.of_pairs(np.array([2.0], np.float32))[0, 2] < 0


def test_a_pair_that_sees_nothing_is_on_no_side():
    found, nothing = Agreement(), np.full(POINTS, np.nan, np.float32)
    found.add(0, {1: residuals(False), 2: residuals(False), 3: nothing}, BORDER)
    sides = found.of_pairs(np.array([2.0], np.float32))
    assert sides[0, 1] == pytest.approx(1)
    assert 0 <= sides[0, 3] < 0.1
    assert Agreement().of_pairs(np.empty(0, np.float32)) == {}


def test_what_is_surrounded_is_rather_the_object():
    labels = np.where(OBJECT, 1.0, -1.0).astype(np.float32)
    assert agreement.vote(labels, BORDER) > agreement.vote(np.full(POINTS, -1, np.float32), BORDER) > 0
    assert agreement.vote(-labels, BORDER) < 0
    assert agreement.vote(np.where(BORDER, np.nan, labels).astype(np.float32), BORDER) == 0

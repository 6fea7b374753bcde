"""Masks scored as DAVIS does, by hand, and carried by chained flow."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import propagation
from harness.davis import contour, region
from tiny_fit import sliding_square
from true_tracker import square_mask


def box(top: int, left: int, size: int = 20) -> np.ndarray:
    mask = np.zeros((60, 80), bool)
    mask[top : top + size, left : left + size] = True
    return mask


def test_j_is_intersection_over_union():
    assert region(box(10, 10), box(10, 20)) == pytest.approx(1 / 3)
    assert region(box(0, 0, 0), box(0, 0, 0)) == 1
    assert region(box(0, 0), box(0, 0, 0)) == 0


def test_f_lets_contours_be_as_far_as_the_tolerance():
    """0.8 % of a diagonal of 100 pixels is 1 pixel, rounded up."""
    assert contour(box(10, 10), box(10, 11)) == 1
    assert contour(box(10, 10), box(13, 13)) < 0.2
    assert contour(box(0, 0, 0), box(0, 0, 0)) == 1
    assert contour(box(10, 10), box(0, 0, 0)) == 0


def test_f_is_of_precision_and_recall():
    """The second box is not found: all that is found is right, and half of what is true."""
    truth = box(5, 5, 10) | box(40, 50, 10)
    assert contour(box(5, 5, 10), truth) == pytest.approx(2 / 3, abs=0.01)


def test_chained_flow_takes_a_mask_along():
    masks = np.stack([square_mask(frame) for frame in range(4)])
    found = list(propagation.chained(masks, sliding_square(4).frames))
    np.testing.assert_array_equal(found[0], masks[0])
    assert region(found[3], masks[3]) > 0.6


def test_a_table_has_each_clip_and_the_mean(tmp_path: Path):
    each = {"j": [0.5, 0.7], "f": [0.4, 0.4]}
    records = {"goat": {"ways": dict.fromkeys(propagation.WAYS, each)}}
    *_, goat, mean = propagation.table(records, {"goat": {"ways": {propagation.CHAINED: each}}})
    assert goat == "| goat | " + " | ".join(["0.600", "0.400"] * 4) + " |"
    assert mean.startswith("| mean of 1 | 0.600")

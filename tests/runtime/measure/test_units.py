"""Scales and recorded times."""

from __future__ import annotations

import re

import numpy as np
import pytest

from decomo_runtime import MeasureError, Scale
from decomo_runtime.measure.units import recorded_times


@pytest.mark.parametrize(
    ("text", "length", "unit"),
    [
        ("0.12mm/px", 0.12, "mm"),
        (" 3 µm / px", 3, "µm"),
        ("3\u03bcm/px", 3, "µm"),
        ("1e-3m/px", 1e-3, "m"),
        (".5in/px", 0.5, "in"),
    ],
)
def test_scales(text: str, length: float, unit: str):
    assert Scale.parse(text) == Scale(length, unit)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("0.12", "has no unit; give a length for each pixel with its unit, such as 0.12mm/px"),
        ("0.12/px", "has no unit"),
        ("0.12mm", "is not a length for each pixel"),
        ("0.12mile/px", "units are nm, um, µm, mm"),
        ("8px/mm", "is not a length for each pixel"),
        ("0mm/px", "is not a length for each pixel"),
        ("-1mm/px", "is not a length for each pixel"),
        ("1e999mm/px", "is not a length for each pixel"),
        ("1.2.3mm/px", "is not a length for each pixel"),
        ("mm/px", "is not a length for each pixel"),
        ("", "is not a length for each pixel"),
    ],
)
def test_what_is_no_scale(text: str, reason: str):
    with pytest.raises(MeasureError, match=re.escape(reason)):
        Scale.parse(text)


def test_wide_pixels_are_longer_along_x():
    assert Scale(0.5, "mm").lengths(1.5).tolist() == [0.75, 0.5]


def test_times_are_the_clip_s_own_unless_a_steady_clip_was_recorded_at_another_rate():
    unsteady, steady = np.array([0, 0.1, 0.5]), np.array([0, 0.1, 0.2])
    assert recorded_times(unsteady, 10.0, None) is unsteady
    np.testing.assert_allclose(recorded_times(steady, 10.0, 240.0), [0, 1 / 240, 2 / 240])
    with pytest.raises(MeasureError, match="leave out --fps, and the clip's own times count"):
        recorded_times(unsteady, 10.0, 240.0)


@pytest.mark.parametrize("fps", [0, -1, float("nan"), float("inf")])
def test_bad_rates(fps: float):
    with pytest.raises(MeasureError, match="must be above 0"):
        recorded_times(np.zeros(1), 10.0, fps)

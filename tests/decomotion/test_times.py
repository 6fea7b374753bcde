"""Whether a rate says when frames are shown."""

from __future__ import annotations

import numpy as np
import pytest

from decomotion.times import is_steady, steady_times


@pytest.mark.parametrize("fps", [1 / 2000, 0.5, 24.0, 30000 / 1001, 600.0])
@pytest.mark.parametrize("begin", [0.0, 7.25])
def test_even_times_are(fps: float, begin: float):
    times = begin + steady_times(40, fps)
    assert is_steady(times, fps)
    assert is_steady(np.rint(1000 * times) / 1000, fps)  # as Matroska has them
    assert is_steady(times[:1], fps)
    assert is_steady(times[:0], fps)


def test_others_are_not():
    assert not is_steady(np.arange(30) / 30, 15.0)  # a header that says half of it
    dropped = np.delete(np.arange(31) / 30, 12)
    assert not is_steady(dropped, 29 / dropped[-1])
    drifting = np.cumsum([0.0, *[0.033] * 50, *[0.040] * 50])  # no two neighbours differ by a quarter
    assert not is_steady(drifting, 100 / drifting[-1])

"""How long a fit takes where nothing is said."""

from __future__ import annotations

from itertools import pairwise

import pytest

from decomotion.default_time import (
    EXPORT,
    EXPORT_OF_A_FRAME,
    LEAST,
    MOST,
    announcement,
    default_seconds,
    rounds,
    spoken,
)
from decomotion.long_clip import USUAL
from decomotion.windows import Windows, split

HALF_AN_HOUR = 1800


def layout(frames: int) -> Windows:
    return Windows("film", frames, 1080, 1920, 30.0, split(frames, [], USUAL))


@pytest.mark.parametrize(
    ("windows", "jobs", "minutes"),
    [(1, 1, 10), (2, 1, 10), (3, 1, 8), (4, 1, 6), (41, 1, 6), (4, 2, 10), (5, 2, 8), (7, 2, 6), (3, 9, 10)],
)
def test_windows_share_a_time_but_have_a_least_and_a_most(windows: int, jobs: int, minutes: float):
    assert default_seconds(windows, jobs) == 60 * minutes


def test_more_windows_never_have_more_and_more_at_a_time_never_less():
    for jobs in (1, 2, 5):
        times = [default_seconds(windows, jobs) for windows in range(1, 60)]
        assert all(LEAST <= later <= sooner <= MOST for sooner, later in pairwise(times))
        assert all(default_seconds(windows, jobs) <= default_seconds(windows, jobs + 1) for windows in range(1, 60))


def test_ten_seconds_of_thirty_frames_are_fitted_and_exported_within_half_an_hour():
    film = layout(300)
    count = len(film.windows)
    export = count * EXPORT + sum(map(len, film.windows)) * EXPORT_OF_A_FRAME
    assert count == 4
    assert default_seconds(count, 1) * rounds(count, 1) + export < HALF_AN_HOUR - 120  # to read the clip, and to start


def test_what_is_said_of_long_clips():
    said = announcement(layout(3600), 1, None, default_seconds(41, 1))
    assert said.startswith(
        "film: 3600 frames of 1920x1080 in 41 windows of up to 100 frames, 1 at a time; 4 h 6 min in all, 6 min for "
        "each, preparation included, then about 17 min of export (--time-budget 410m gives each 10 min; less means "
    )
    assert "2 h 6 min in all, 6 min" in announcement(layout(3600), 2, None, default_seconds(41, 2))


def test_what_is_said_of_one_window():
    said = announcement(layout(32), 1, None, default_seconds(1, 1))
    assert said.startswith(
        "film: 32 frames of 1920x1080; 10 min, preparation included, then about 1 min of export (--t"
    )
    assert "90 s, preparation" in announcement(layout(32), 1, None, 90.0)
    assert announcement(layout(32), 1, 7, None).endswith("; 7 steps (--time-budget or --steps say otherwise)")


@pytest.mark.parametrize(
    ("seconds", "said"),
    [
        (119.4, "119 s"),
        (120.0, "2 min"),
        (179.0, "3 min"),
        (3569.0, "59 min"),
        (3571.0, "1 h 0 min"),
        (24600.0, "6 h 50 min"),
    ],
)
def test_times_are_said_to_the_minute(seconds: float, said: str):
    assert spoken(seconds) == said


def test_more_time_is_advised_where_windows_have_less_than_ten_minutes():
    """Of 41 windows, two at a time, 21 are fitted one after the other."""
    assert "(--time-budget 210m gives each 10 min; less" in announcement(layout(3600), 2, None, 360.0)
    assert "(--time-budget or --steps say otherwise; less" in announcement(layout(3600), 2, None, 600.0)

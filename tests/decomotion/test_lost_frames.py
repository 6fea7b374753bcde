"""The sentence on what a damaged recording has lost, from what decoding met and the frames' times."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from decomotion.lost_frames import PLACES, Loss, Met, lost_frames


def met(times: Sequence[float], keys: Sequence[int] = (0,), **more: object) -> Met:
    """Frames kept at these times, of which those of the numbers `keys` are key frames."""
    return Met(list(times), [number in keys for number in range(len(times))], **more)  # type: ignore[arg-type]


def sentence(found: Met) -> str | None:
    times = np.array(found.times, np.float64)
    return lost_frames("film.mp4", found, times - times[0])


EVEN = [number / 10 for number in range(40)]


def test_nothing_is_lost():
    assert sentence(met(EVEN)) is None
    assert sentence(met(EVEN[:1])) is None
    assert lost_frames("film.mp4", Met(), None) is None


def test_a_gap_without_a_trace_may_be_a_standstill():
    assert sentence(met(EVEN[:7] + EVEN[10:])) == (
        "film.mp4 lacks 3 frames, or stood still: 3 after frame 6 (0.60 s); the other 37 are kept and counted from 0"
    )


def test_what_did_not_decode_is_counted_once():
    """Decoding met one of the three at frame 5, since it gives frames late; the times tell where they are."""
    found = met(EVEN[:7] + EVEN[10:], keys=(0, 20), losses=[Loss(5, 0.8)])
    assert sentence(found) == (
        "film.mp4 is damaged and has lost 3 frames: 3 after frame 6 (0.60 s); the other 37 are kept and counted from "
        "0; 13 of frames 7 to 19 build on lost ones and may be smeared"
    )


def test_more_may_be_met_than_the_gap_holds():
    found = met(EVEN[:7] + EVEN[8:], keys=range(39), losses=[Loss(7, 0.68), Loss(7, 0.72)])
    assert "has lost 2 frames: 2 after frame 6 (0.60 s)" in str(sentence(found))


def test_times_that_do_not_begin_at_zero():
    found = met([time + 3 for time in EVEN[:7] + EVEN[8:]], keys=(0, 7), losses=[Loss(9, 3.7)])
    assert sentence(found) == (
        "film.mp4 is damaged and has lost 1 frame: 1 after frame 6 (0.60 s); the other 39 are kept and counted from 0"
    )


def test_at_the_begin_and_at_the_end():
    assert sentence(met(EVEN, losses=[Loss(0, -0.1)], keys=(0,), unread=5)) == (
        "film.mp4 is damaged and has lost 6 frames: 1 before the first that is kept, 5 after frame 39 (3.90 s); the "
        "other 40 are kept and counted from 0"
    )


def test_an_uneven_rate_has_no_gaps():
    times = np.cumsum([0.1, 0.1, 0.3] * 12).tolist()
    assert sentence(met(times)) is None
    assert sentence(met(times, keys=range(36), losses=[Loss(4, times[4] - 0.05)])) == (
        "film.mp4 is damaged and has lost 1 frame: 1 after frame 3 (0.50 s); the other 36 are kept and counted from 0"
    )


def test_without_times_the_order_tells():
    found = Met([None] * 6, [True] * 6, losses=[Loss(2, None), Loss(2, None), Loss(4, None)])
    assert lost_frames("film.avi", found, None) == (
        "film.avi is damaged and has lost 3 frames: 2 after frame 1, 1 after frame 3; the other 6 are kept and counted "
        "from 0"
    )


@pytest.mark.parametrize("places", [PLACES, PLACES + 2])
def test_many_places_are_not_all_named(places: int):
    times = [number / 10 for number in range(200) if number % 20 != 10 or number > 20 * places]
    said = sentence(met(times))
    assert said is not None
    assert said.count("after frame") == PLACES
    assert (" and at 2 more places;" in said) == (places > PLACES)

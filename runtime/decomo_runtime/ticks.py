"""When the frames of a video are shown, in whole ticks, as its file has them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from itertools import count, pairwise

import numpy as np
import numpy.typing as npt

from decomo_runtime.errors import RenderError
from decomotion.times import is_steady

LARGEST = 1001
"""Denominator of a rate, for 30000/1001."""
_TICK, _SLOW_TICK = Fraction(1, 90_000), Fraction(1, 1000)
_LONG = 1000
"""Seconds; the second tick is for frames that are shown for longer, as a file has 31 bits for a frame's length."""
LONGEST = 100_000
"""Seconds that a frame can be shown for: FFmpeg parts what it is given into 16,000 a second."""
FASTEST = 1_000_000
"""Frames a second: a rate is a fraction of two numbers of 31 bits."""


@dataclass(frozen=True)
class Ticks:
    """A video's own clock."""

    rate: Fraction
    """Frames a second, for the encoder: about that, where `steady` is false."""
    tick: Fraction
    """Seconds."""
    shown: Iterator[tuple[int, int]]
    """Of each frame, when it begins and how long it is shown; without end where only the rate was given."""
    steady: bool
    """Whether each frame is one tick."""


def ticks_of(fps: float, times: npt.ArrayLike | None = None) -> Ticks:
    """Of frames at `fps` a second, or at `times` [frame], in seconds, rising; the last is as long as that before it.

    Raises `RenderError` where a frame would be shown for longer than `LONGEST`, or `fps` is above `FASTEST`.
    """
    if not 0 < fps <= FASTEST:
        raise RenderError(f"no video can have {fps:g} frames a second, at most {FASTEST:,}; write images instead")
    if times is not None and is_steady(times, fps):
        times = None
    if times is None and fps >= 1:
        rate = Fraction(fps).limit_denominator(LARGEST)
        return Ticks(rate, 1 / rate, ((number, 1) for number in count()), True)
    longest = 1 / fps if times is None else float(np.diff(np.asarray(times, np.float64)).max())
    if longest > LONGEST:
        raise RenderError(f"no video can show a frame for {longest:.6g} s, at most {LONGEST:,}; write images instead")
    rate = max(Fraction(fps).limit_denominator(LARGEST), Fraction(1, LARGEST))
    if times is None:
        tick = _SLOW_TICK if 1 / fps > _LONG else _TICK
        begins = (round(number / fps / tick) for number in count())
    else:
        seconds = np.asarray(times, np.float64)
        tick = _SLOW_TICK if np.diff(seconds).max() > _LONG else _TICK
        apart = np.arange(len(seconds)) * round(_SLOW_TICK / tick)  # no two in one millisecond, which webm counts
        whole = np.rint((seconds - seconds[0]) / float(tick)).astype(np.int64)
        whole = np.maximum.accumulate(whole - apart) + apart
        begins = iter([*whole.tolist(), int(2 * whole[-1] - whole[-2])])
    return Ticks(rate, tick, ((begin, end - begin) for begin, end in pairwise(begins)), False)

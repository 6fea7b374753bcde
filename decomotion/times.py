"""When the frames of a clip are shown, and whether its rate alone says so."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

ROUNDING = 0.002
"""Seconds by which containers that count milliseconds move a frame, and the rate that follows from such times."""


def steady_times(count: int, fps: float) -> npt.NDArray[np.float64]:
    """[count], seconds: frames that follow each other at `fps` frames a second, the first at 0."""
    return np.arange(count) / fps


def is_steady(times: npt.ArrayLike, fps: float) -> bool:
    """Whether `times` [frame], in seconds, are those of frames at `fps` frames a second, to `ROUNDING`."""
    seconds = np.asarray(times, np.float64)
    return bool((np.abs(seconds - seconds[:1] - steady_times(len(seconds), fps)) <= ROUNDING).all())

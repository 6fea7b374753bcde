"""Units of what is measured: a scale from pixels to lengths, and the seconds at which frames were recorded."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from decomo_runtime.errors import MeasureError
from decomotion.times import is_steady, steady_times

LENGTHS = ("nm", "um", "µm", "mm", "cm", "m", "km", "in", "ft")
PIXEL = "px"
_FORM = "a length for each pixel with its unit, such as 0.12mm/px"


@dataclass(frozen=True)
class Scale:
    """How long a pixel is."""

    length: float = 1.0
    """Of a pixel's height; its width is that times the clip's pixel aspect."""
    unit: str = PIXEL
    """One of `LENGTHS`, or pixels."""

    @classmethod
    def parse(cls, text: str) -> Scale:
        """Of `"0.12mm/px"`. `MeasureError` where it is none."""
        written = text.replace("\u03bc", "\u00b5")  # the Greek letter for the micro sign
        match = re.fullmatch(r"\s*([0-9.]+(?:[eE][+-]?[0-9]+)?)\s*(.*?)\s*(?:/\s*px)?\s*", written)
        try:
            length, unit = (float(match[1]), match[2]) if match else (math.nan, "")
        except ValueError:
            length, unit = math.nan, ""
        if length > 0 and unit == "":
            raise MeasureError(f"--scale {text} has no unit; give {_FORM}")
        if unit not in LENGTHS or not 0 < length < math.inf or "/" not in text:
            raise MeasureError(f"--scale {text} is not {_FORM}; units are {', '.join(LENGTHS)}")
        return cls(length, unit)

    def lengths(self, pixel_aspect: float) -> npt.NDArray[np.float64]:
        """[2]: how long a pixel of that width over height is along x and y."""
        return self.length * np.array([pixel_aspect, 1.0])


def recorded_times(times: npt.NDArray[np.float64], clip_fps: float, fps: float | None) -> npt.NDArray[np.float64]:
    """[T], seconds at which the frames of a clip, shown at `times` [T], were recorded: those, or `fps` frames a second.

    `MeasureError` where `fps` is not above 0, or the clip's frames do not follow each other steadily, so that one rate
    cannot say when.
    """
    if fps is None:
        return times
    if not 0 < fps < math.inf:
        raise MeasureError(f"--fps {fps:g} must be above 0: frames a second as the camera recorded them")
    if not is_steady(times, clip_fps):
        raise MeasureError(
            "the clip's frames are not equally far apart in time, so that no one rate says when they were recorded; "
            "leave out --fps, and the clip's own times count"
        )
    return steady_times(len(times), float(fps))

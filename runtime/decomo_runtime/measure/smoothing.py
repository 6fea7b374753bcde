"""Derivatives along time by local polynomials: Savitzky and Golay's smoothing, for times of any spacing.

Around each sample a polynomial of `order` is fitted by least squares to the `window` samples that are nearest by their
number. At the ends these lie on one side, and the polynomial is read there where it is least certain; `gain` says
how much: the deviation of the velocity where each place has a deviation of 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from decomo_runtime.errors import MeasureError

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Smoothing:
    """A window, odd, and an order, at least 2 and below the window, so that there is an acceleration."""

    window: int = 7
    """Samples."""
    order: int = 2
    """Of the polynomial."""

    def __post_init__(self) -> None:
        if self.window % 2 == 0 or not 2 <= self.order < self.window:
            raise MeasureError(
                f"--smooth {self.window},{self.order} must be an odd number of frames and an order from 2 up to below "
                f"it, such as {Smoothing.window},{Smoothing.order}"
            )

    @classmethod
    def parse(cls, text: str) -> Smoothing:
        """Of `"WINDOW,ORDER"`."""
        try:
            window, order = (int(part) for part in text.split(","))
        except ValueError as error:
            raise MeasureError(
                f"--smooth {text} is not WINDOW,ORDER: a number of frames and an order, such as 7,2"
            ) from error
        return cls(window, order)


@dataclass(frozen=True, eq=False)
class Derivatives:
    """Of N series of M samples; nan where too few are known."""

    velocity: Floats
    """[N, M, 2], a second."""
    acceleration: Floats
    """[N, M, 2], a second squared."""
    gain: Floats
    """[N, M], one by seconds: the velocity's deviation where each place deviates by 1."""
    used: npt.NDArray[np.int64]
    """[N, M], samples that the polynomial was fitted to."""


def derivatives(places: Floats, times: Floats, hidden: npt.NDArray[np.bool_], smoothing: Smoothing) -> Derivatives:
    """Of `places` [N, M, 2] at `times` [M], seconds, rising.

    A sample in sight is fitted to samples in sight alone, a hidden one [N, M] to all. `MeasureError` where there are
    fewer samples than the window.
    """
    count, window, order = len(times), smoothing.window, smoothing.order
    if count < window:
        raise MeasureError(
            f"--smooth {window},{order} needs {window} frames but there are {count}; give a smaller "
            "window, or more frames"
        )
    shape = places.shape[:2]
    velocity, acceleration = np.full(places.shape, np.nan), np.full(places.shape, np.nan)
    gain, used = np.full(shape, np.nan), np.zeros(shape, np.int64)
    for column in range(count):
        begin = min(max(0, column - window // 2), count - window)
        part = slice(begin, begin + window)
        unit = (times[begin + window - 1] - times[begin]) / 2  # of the polynomial's argument, which is then about 1
        powers = ((times[part] - times[column]) / unit)[:, None] ** np.arange(order + 1)
        weights = (~hidden[:, part] | hidden[:, column, None]) & np.isfinite(places[:, part]).all(-1)
        used[:, column] = weights.sum(1)
        rows = np.flatnonzero(used[:, column] > order)
        if len(rows) == 0:
            continue
        patterns, which = np.unique(weights[rows], axis=0, return_inverse=True)
        solve = np.linalg.pinv(powers * patterns[:, :, None])[which.reshape(-1)]  # [n, order + 1, window]
        series = np.where(weights[rows][:, :, None], places[rows, part] - places[rows, column, None], 0)
        coefficients = solve @ np.nan_to_num(series)
        velocity[rows, column] = coefficients[:, 1] / unit
        acceleration[rows, column] = 2 * coefficients[:, 2] / unit**2
        gain[rows, column] = np.linalg.norm(solve[:, 1], axis=-1) / unit
    return Derivatives(velocity, acceleration, gain, used)

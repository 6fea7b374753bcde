"""Confidence interval of a mean over videos, by the percentile bootstrap (Efron 1979): what other videos would give."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

LEVEL = 0.95
"""Share of the resampled means inside the interval."""
RESAMPLES = 2000


def mean_interval(values: npt.ArrayLike, *, seed: int = 0) -> tuple[float, float]:
    """Lower and upper end of the interval of the mean of `values` [n], one value a video.

    The same values give the same interval, in whatever order. nan are left out; with fewer than two values left there
    is nothing to resample and both ends are nan.
    """
    values = np.asarray(values, dtype=np.float64)
    values = np.sort(values[~np.isnan(values)])
    if len(values) < 2:
        return math.nan, math.nan
    drawn = np.random.default_rng(seed).integers(0, len(values), (RESAMPLES, len(values)))
    low, high = np.quantile(values[drawn].mean(axis=1), [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return float(low), float(high)

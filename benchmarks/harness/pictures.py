"""How close pictures and masks come to the true ones."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

Mask = npt.NDArray[np.bool_]


def psnr(picture: npt.NDArray[np.uint8], truth: npt.NDArray[np.uint8]) -> float:
    """Peak signal-to-noise ratio of two 8-bit pictures of one shape, in dB; infinite where they are equal."""
    error = np.mean(np.square(picture.astype(np.float64) - truth))
    return 10 * math.log10(255**2 / error) if error > 0 else math.inf


def intersection_over_union(mask: Mask, truth: Mask) -> float:
    """Mean over frames of two masks [frame, H, W]; 1 in frames where both are empty."""
    both, either = (mask & truth).sum(axis=(1, 2)), (mask | truth).sum(axis=(1, 2))
    return float(np.where(either > 0, both / np.maximum(either, 1), 1).mean())

"""Pictures read between their pixels."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

_ROW = 1024
"""Places are asked for in rows of so many: cv2.remap takes no more columns or rows than a short counts."""
_MEDIANS = 1 << 16
"""Medians are taken of so many places at a time: what that takes beside them is little, and stays in caches."""


def sampled(
    image: npt.NDArray[Any],
    places: npt.NDArray[np.floating],
    interpolation: int = cv2.INTER_LINEAR,
    outside: float | None = None,
) -> Any:
    """`image` [H, W] or [H, W, C] at `places` [..., 2], (x, y) in its pixels; [...] or [..., C] of the image's type.

    Beyond its borders it is `outside`, or goes on as there.
    """
    shape, count = (*places.shape[:-1], *image.shape[2:]), places[..., 0].size
    if count == 0:
        return np.empty(shape, image.dtype)
    there = np.zeros((2, -(-count // _ROW), _ROW), np.float32)
    there.reshape(2, -1)[:, :count] = places.reshape(-1, 2).T
    border = cv2.BORDER_REPLICATE if outside is None else cv2.BORDER_CONSTANT
    value = (0.0 if outside is None else outside,) * 4
    read = cv2.remap(image, there[0], there[1], interpolation, borderMode=border, borderValue=value)
    return read.reshape(-1, *image.shape[2:])[:count].reshape(shape)


def known_median(values: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Median over the first axis of those of `values` [N, ...] that are numbers; nan where none is."""
    rows = values.reshape(len(values), -1)
    median = np.empty(rows.shape[1], np.float32)
    for begin in range(0, len(median), _MEDIANS):
        part = slice(begin, begin + _MEDIANS)
        known = np.isfinite(rows[:, part]).sum(axis=0, keepdims=True)
        ordered = np.sort(rows[:, part], axis=0)  # what is no number comes last
        low, high = (np.take_along_axis(ordered, at, axis=0)[0] for at in ((known - 1).clip(0) // 2, known // 2))
        median[part] = (low + high) / 2
    return median.reshape(values.shape[1:])

"""Polygons as masks and back. Corners are pixels with centres at whole numbers."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

FINE = 4
"""Parts of a pixel, either way, by which it is told how much of it lies within."""
SLACK = 1.0
"""Pixels that an outline may leave its mask's rim, so that it has few corners."""
MOST = 2**15
"""Pixels; no corner is farther from the frame."""


def filled(polygons: Sequence[Floats], size: tuple[int, int]) -> Mask:
    """[H, W], the pixels of which at least half is within one of the polygons [P, 2]."""
    mask = np.zeros(size, bool)
    for polygon in polygons:
        low = np.floor(polygon.min(axis=0)).astype(int).clip(0, size[::-1])
        high = (np.ceil(polygon.max(axis=0)).astype(int) + 1).clip(low, size[::-1])
        width, height = high - low
        if width and height:
            canvas = np.zeros((height * FINE, width * FINE), np.uint8)
            corners = ((polygon - low + 0.5) * FINE - 0.5) * 2**4
            cv2.fillPoly(canvas, [np.rint(corners).astype(np.int32)], (1,), shift=4)
            within = (
                canvas.reshape(height, FINE, width, FINE).mean(axis=(1, 3)) > 0.5
            )  # what is touched counts: half is more
            mask[low[1] : high[1], low[0] : high[0]] |= within
    return mask


def outlines(mask: Mask) -> list[Floats]:
    """The outer rims of the mask's parts, [P, 2] each, the largest first; holes are not told."""
    left, top, width, height = cv2.boundingRect(mask.astype(np.uint8))
    part = mask[top : top + height, left : left + width].astype(np.uint8)
    fine = np.repeat(np.repeat(part, FINE, axis=0), FINE, axis=1)
    found, _ = cv2.findContours(fine, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    found = sorted(found, key=cv2.contourArea, reverse=True)
    simple = [cv2.approxPolyDP(each, SLACK * FINE, True)[:, 0] for each in found]
    return [(each + 0.5) / FINE - 0.5 + (left, top) for each in simple if len(each) >= 3]


def box_around(mask: Mask) -> Floats:
    """[2, 2], the corners of the pixels' borders, upper left and lower right."""
    left, top, width, height = cv2.boundingRect(mask.astype(np.uint8))
    return np.array([[left, top], [left + width, top + height]], np.float64) - 0.5

"""Masks scored as DAVIS scores them (Perazzi et al., CVPR 2016): J, of regions, and F, of contours."""

from __future__ import annotations

import math

import cv2
import numpy as np
import numpy.typing as npt

Mask = npt.NDArray[np.bool_]

TOLERANCE = 0.008
"""Of a contour's place, as a share of the frame's diagonal."""


def region(mask: Mask, truth: Mask) -> float:
    """J of two masks [H, W]: intersection over union; 1 where both are empty."""
    either = (mask | truth).sum()
    return float((mask & truth).sum() / either) if either else 1.0


def contour(mask: Mask, truth: Mask) -> float:
    """F of two masks [H, W]: of the contours' precision and recall within the tolerance; 1 where both are empty."""
    radius = math.ceil(TOLERANCE * math.hypot(*mask.shape))
    y, x = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    disk = (x**2 + y**2 <= radius**2).astype(np.uint8)
    found, true = _contour(mask), _contour(truth)
    if not found.any() or not true.any():
        return float(found.any() == true.any())
    precision = (found & (cv2.dilate(true.astype(np.uint8), disk) > 0)).sum() / found.sum()
    recall = (true & (cv2.dilate(found.astype(np.uint8), disk) > 0)).sum() / true.sum()
    return float(2 * precision * recall / (precision + recall)) if precision + recall else 0.0


def _contour(mask: Mask) -> Mask:
    """[H, W], pixels that differ from one to the right of, below, or below and right of them, the last row's and
    column's own apart.
    """
    below = np.vstack([mask[1:], mask[-1:]])
    right = np.hstack([mask[:, 1:], mask[:, -1:]])
    across = np.vstack([right[1:], right[-1:]])
    rim = (mask ^ below) | (mask ^ right) | (mask ^ across)
    rim[-1] = mask[-1] ^ right[-1]
    rim[:, -1] = mask[:, -1] ^ below[:, -1]
    rim[-1, -1] = False
    return rim

"""Bilinear look-ups of images and maps at points."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

MOST_CHANNELS = 4
"""Of an image that OpenCV's remap takes."""


def sample_image(image: npt.NDArray, xy: npt.NDArray[np.float32]) -> npt.NDArray:
    """Values [point, c] of an image [H, W, c], c at most 4, at `xy` [point, 2] in its pixels, border repeated."""
    return cv2.remap(image, xy[None], None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[0]  # type: ignore[call-overload]


def sample_map(
    image: npt.NDArray[np.float32], xy: npt.NDArray[np.float32], height: int, width: int
) -> npt.NDArray[np.float32]:
    """Values [point, c] of a map [h, w, c] that covers a frame of that size, at `xy` in the frame's pixels."""
    where = (xy + 0.5) * np.array([image.shape[1] / width, image.shape[0] / height], np.float32) - 0.5
    parts = [
        np.ascontiguousarray(image[..., first : first + MOST_CHANNELS])
        for first in range(0, image.shape[-1], MOST_CHANNELS)
    ]
    return np.concatenate([sample_image(part, where).reshape(len(where), -1) for part in parts], axis=-1)

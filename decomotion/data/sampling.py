"""Bilinear look-ups of images and maps at points."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt

MOST_CHANNELS = 4
"""Of an image that OpenCV's remap takes."""
MOST_POINTS = 32_000
"""In a row of what it returns, whose sides it counts in 16 bits."""


def bilinear(image: npt.NDArray, xy: npt.NDArray[np.float32]) -> npt.NDArray:
    """Values [..., c] of an image [H, W] or [H, W, c], c at most 4, at `xy` [..., point, 2], border repeated.

    Positions are in pixels of the image.
    """
    return _read(image, xy, cv2.INTER_LINEAR)


def nearest(mask: npt.NDArray[np.bool_], xy: npt.NDArray[np.float32]) -> npt.NDArray[np.bool_]:
    """[..., point]: a mask [H, W] at the pixels nearest to `xy` [..., point, 2], border repeated."""
    return _read(mask.view(np.uint8), xy, cv2.INTER_NEAREST)[..., 0].astype(np.bool_)


def _read(image: npt.NDArray, xy: npt.NDArray[np.float32], how: int) -> npt.NDArray:
    count = xy.shape[-2]
    if count > MOST_POINTS:
        parts = np.split(xy, range(MOST_POINTS, count, MOST_POINTS), axis=-2)
        return np.concatenate([_read(image, part, how) for part in parts], axis=-2)
    rows = np.ascontiguousarray(xy).reshape(-1, count, 2)
    values = cv2.remap(image, rows, None, how, borderMode=cv2.BORDER_REPLICATE)  # type: ignore[call-overload]
    return values.reshape(*xy.shape[:-1], -1)


@lru_cache(2)
def pixels(height: int, width: int) -> npt.NDArray[np.float32]:
    """(x, y) of each pixel of a raster, [h, w, 2], not to be written to."""
    return np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).astype(np.float32)


def rescaled(xy: npt.NDArray[np.float32], sides: tuple[int, int], others: tuple[int, int]) -> npt.NDArray[np.float32]:
    """Positions [..., 2] in pixels of an image of that height and width, in those of a raster of the same image."""
    scale = np.array([others[1] / sides[1], others[0] / sides[0]], np.float32)
    return ((xy + np.float32(0.5)) * scale - np.float32(0.5)).astype(np.float32)


def sample_map(
    image: npt.NDArray[np.float32], xy: npt.NDArray[np.float32], height: int, width: int
) -> npt.NDArray[np.float32]:
    """Values [point, c] of a map [h, w, c] that covers a frame of that size, at `xy` in the frame's pixels."""
    where = rescaled(xy, (height, width), (image.shape[0], image.shape[1]))
    parts = [
        np.ascontiguousarray(image[..., first : first + MOST_CHANNELS])
        for first in range(0, image.shape[-1], MOST_CHANNELS)
    ]
    return np.concatenate([bilinear(part, where) for part in parts], axis=-1)

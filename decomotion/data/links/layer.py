"""The layer of what moves: flow of it alone, and where it can be.

A patch on a leg is half grass, and the grass wins. So what the masks do not hold is made grey in both frames, and the
flow of what remains is searched in the part of the frame that it fills. Linking takes it for one more way to go.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt

from decomotion.data.flow.interface import Flow, FlowEstimator, Frame, Size, resized
from decomotion.units import unit

Mask = npt.NDArray[np.bool_]

GREY = 128
"""What stands for the rest of a frame."""
MARGIN = 16.0
"""Units of it that are searched around what moves."""
GIVEN_TOLERANCE, DRAWN_TOLERANCE = 1.0, 2.0
"""Units by which an outline may be off that is given, and one that a network has drawn."""
AT_HAND = 32
"""Frames whose masks are kept unpacked."""


class Layer:
    """Masks on the raster of the fields.

    Args:
        masks: [H, W] each, one a frame, at any size.
        size: width and height of the raster.
        tolerance: units by which their outlines may be off.
    """

    def __init__(self, masks: Iterable[Mask], size: Size, tolerance: float = GIVEN_TOLERANCE) -> None:
        width, height = self._size = size
        self._packed = [np.packbits(_brought_to(mask, size)) for mask in masks]

        def unpacked(frame: int) -> Mask:
            bits = np.unpackbits(self._packed[frame], count=width * height)
            return bits.reshape(height, width).astype(np.bool_)

        self.mask = lru_cache(AT_HAND)(unpacked)
        """`mask(frame)`: [h, w], what moves."""
        self.reach = lru_cache(AT_HAND)(lambda frame: _wider(unpacked(frame), tolerance * unit(*size)))
        """`reach(frame)`: [h, w], where it can lie, its outline being a little off; everywhere where there is none."""
        self.part = lru_cache(AT_HAND)(self._part)
        """`part(i, j)`: rows and columns that are searched from frame i to j; None where one of them has nothing."""

    def effort(self) -> float:
        """Share of a frame that is searched, in the mean."""
        parts = [self.part(frame, frame) for frame in range(len(self._packed))]
        boxes = [(rows.stop - rows.start) * (columns.stop - columns.start) for rows, columns in filter(None, parts)]
        return sum(boxes) / (len(parts) * self._size[0] * self._size[1])

    def empty(self) -> Flow:
        """No motion, [h, w, 2]."""
        return np.zeros((*self._size[::-1], 2), np.float32)

    def flow(self, estimator: FlowEstimator, frames: tuple[Frame, Frame], pair: tuple[int, int]) -> Flow:
        """From the first of `frames` to the second, [h, w, 2], of what moves; 0 far from it."""
        flow = self.empty()
        if (part := self.part(*pair)) is not None:
            first, second = (self._alone(frame, number)[part] for frame, number in zip(frames, pair, strict=True))
            start = np.broadcast_to(self._middle(pair[1]) - self._middle(pair[0]), flow[part].shape)
            flow[part] = estimator(first, second, pair, start.astype(np.float32))
        return flow

    def _middle(self, frame: int) -> npt.NDArray[np.float64]:
        """(x, y), the mean of the pixels that move."""
        return np.argwhere(self.mask(frame)).mean(axis=0)[::-1]

    def _alone(self, frame: Frame, number: int) -> Frame:
        """What moves, brought to the raster, and grey."""
        return np.where(self.mask(number)[..., None], resized(frame, self._size), np.uint8(GREY))

    def _part(self, first: int, second: int) -> tuple[slice, slice] | None:
        masks = self.mask(first), self.mask(second)
        if not all(mask.any() for mask in masks):
            return None
        margin = round(MARGIN * unit(*self._size))
        either = masks[0] | masks[1]
        rows, columns = (
            slice(max(0, axis.min() - margin), min(side, axis.max() + margin + 1))
            for axis, side in zip(np.nonzero(either), either.shape, strict=True)
        )
        return rows, columns


def _brought_to(mask: Mask, size: Size) -> Mask:
    return resized(np.uint8(255) * mask, size) > 127


def _wider(mask: Mask, radius: float) -> Mask:
    if not mask.any():
        return np.ones_like(mask)
    return cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE) <= radius

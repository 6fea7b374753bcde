"""What annotated frames teach of their objects' looks: which volume owns their pixels, and their colours.

Both are histograms over the pixels of the annotated frames, one for each class: 0 is what no object is, then the
objects.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float32]

OWNER_BINS = 16
"""Of static confidence."""
COLOUR_BINS = 16
"""Of each channel of CIELAB."""
FEW = 2.0
"""Pixels that every bin has to begin with."""
RARE = 1e-5
"""Share of a class's colours that every bin has to begin with."""
_SMOOTHING = np.array([0.25, 0.5, 0.25])


class Looks:
    """Histograms of `classes`, to which annotated frames are added."""

    def __init__(self, classes: int) -> None:
        self._owners = np.zeros((classes, OWNER_BINS))
        self._colours = np.zeros((classes, *(COLOUR_BINS,) * 3))

    def add(self, number: int, share: Floats, confidence: Floats, picture: Floats) -> None:
        """Of an annotated frame: `share` [h, w] of class `number` in each pixel, static confidence [h, w], and
        `picture` [h, w, 3], RGB in [0, 1].
        """
        np.add.at(self._owners[number], _owner_bins(confidence), share)
        np.add.at(self._colours[number], _colour_bins(picture), share)

    def by_owner(self, confidence: Floats) -> Floats:
        """[class, h, w], the chance of each class by static confidence [h, w]."""
        counts = _smoothed(self._owners, 1) + FEW
        return _chances(counts)[:, _owner_bins(confidence)]

    def by_colour(self, picture: Floats) -> Floats:
        """[class, h, w], the chance of each class by a picture [h, w, 3], RGB in [0, 1], if all are as large."""
        counts = self._colours
        for axis in (1, 2, 3):
            counts = _smoothed(counts, axis)
        shares = counts / np.maximum(counts.sum(axis=(1, 2, 3), keepdims=True), 1) + RARE
        return _chances(shares)[(slice(None), *_colour_bins(picture))]


def _chances(counts: npt.NDArray[np.float64]) -> Floats:
    return (counts / counts.sum(axis=0)).astype(np.float32)


def _smoothed(counts: npt.NDArray[np.float64], axis: int) -> npt.NDArray[np.float64]:
    pad = [(0, 0)] * counts.ndim
    pad[axis] = (1, 1)
    padded, length = np.pad(counts, pad, mode="edge"), counts.shape[axis]
    return sum(  # pyright: ignore[reportReturnType]
        weight * np.take(padded, range(shift, shift + length), axis) for shift, weight in enumerate(_SMOOTHING)
    )


def _owner_bins(confidence: Floats) -> npt.NDArray[np.int64]:
    return np.clip((1 - confidence) * OWNER_BINS, 0, OWNER_BINS - 1).astype(np.int64)


def _colour_bins(picture: Floats) -> tuple[npt.NDArray[np.int64], ...]:
    lab = cv2.cvtColor(np.rint(picture * 255).astype(np.uint8), cv2.COLOR_RGB2LAB)
    return tuple(np.moveaxis(lab // (256 // COLOUR_BINS), -1, 0).astype(np.int64))

"""Dense SIFT, as kornia's `DenseSIFTDescriptor` makes it, but centred on pixels and several times as fast: no weights.

kornia counts the gradients' orientations. Their histograms are pooled, gathered and scaled here, band by band, so that
what is worked on stays in the processor's cache; kornia gathers the cells of a descriptor by a convolution.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import cv2
import numpy as np
import numpy.typing as npt
import torch

from decomotion.data.features.interface import FEATURE_SIDE, FeatureMap, resized

if TYPE_CHECKING:
    from kornia.feature import DenseSIFTDescriptor

BINS, CELLS, CELL = 8, 4, 4
"""Of a descriptor: orientations, cells along a side, and pixels between the cells."""
CLIPPED = 0.2
"""No entry of a descriptor of unit norm is larger."""
POOLING = np.array([0.25, 1.0, 1.5, 1.0, 0.25], np.float32) / 2
"""kornia's triangle over four pixels, half a pixel to either side, so that its centre is a pixel."""
BAND = 8
"""Rows that are described at a time."""


class DenseSift:
    """See `FeatureExtractor`; channels by cell, row by row, and orientation."""

    channels = BINS * CELLS**2

    def __call__(self, frame: npt.NDArray[np.uint8]) -> FeatureMap:
        """Descriptors of a frame, which is reduced to `FEATURE_SIDE` first."""
        grey = cv2.cvtColor(resized(frame, FEATURE_SIDE), cv2.COLOR_RGB2GRAY)
        height, width = grey.shape
        with torch.inference_mode():
            counted = self._kornia.get_gradient_histograms(torch.from_numpy(grey).float()[None, None] / 255)[0].numpy()
        reach = CELL * (CELLS - 1) // 2
        pooled = np.zeros((height + 2 * reach, width + 2 * reach, BINS), np.float32)
        for number, histogram in enumerate(counted):
            smooth = cv2.sepFilter2D(histogram, -1, POOLING, POOLING, borderType=cv2.BORDER_CONSTANT)
            pooled[reach : reach + height, reach : reach + width, number] = smooth
        described = np.empty((height, width, CELLS, CELLS, BINS), np.float32)
        for top in range(0, height, BAND):
            band = described[top : top + BAND]
            for row in range(CELLS):
                first = top + row * CELL
                for column in range(CELLS):
                    left = column * CELL
                    band[:, :, row, column] = pooled[first : first + len(band), left : left + width]
            _scale(band.reshape(-1, self.channels))
        return described.reshape(height, width, self.channels)

    @cached_property
    def _kornia(self) -> DenseSIFTDescriptor:
        from kornia.feature import DenseSIFTDescriptor

        return DenseSIFTDescriptor(num_ang_bins=BINS, num_spatial_bins=CELLS, spatial_bin_size=CELL)


def _scale(described: npt.NDArray[np.float32]) -> None:
    """To RootSIFT (Arandjelović and Zisserman 2012), in place: [descriptor, channel]; a blank one stays blank."""
    norm = np.sqrt(np.einsum("dc,dc->d", described, described))
    np.minimum(described, CLIPPED * norm[:, None], out=described)
    described /= np.maximum(described.sum(axis=1, keepdims=True), 1e-12)
    np.sqrt(described, out=described)

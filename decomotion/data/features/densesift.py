"""kornia's dense SIFT: no weights."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
import torch
import torch.nn.functional as F

from decomotion.data.features.interface import FEATURE_SIDE, FeatureMap, resized

PADDING = 6
"""Pixels of zeros around the frame's gradients, so that there is a descriptor at every pixel."""


class DenseSift:
    """See `FeatureExtractor`."""

    channels = 128

    def __call__(self, frame: npt.NDArray[np.uint8]) -> FeatureMap:
        """Descriptors of a frame, which is reduced to `FEATURE_SIDE` first."""
        from kornia.feature import DenseSIFTDescriptor

        grey = cv2.cvtColor(resized(frame, FEATURE_SIDE), cv2.COLOR_RGB2GRAY)
        height, width = grey.shape
        with torch.inference_mode():
            described = DenseSIFTDescriptor(padding=PADDING)(torch.from_numpy(grey).float()[None, None] / 255)
            # kornia's raster is centred on the frame's and larger: by one pixel here, with half a pixel on each side
            if (described.shape[-1] - width) % 2:
                described = F.normalize(F.avg_pool2d(described, 2, stride=1), dim=1)
        margin = (described.shape[-1] - width) // 2
        return described[0, :, margin : margin + height, margin : margin + width].permute(1, 2, 0).numpy()

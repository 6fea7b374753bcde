"""What a feature extractor is."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import cv2
import numpy as np
import numpy.typing as npt

FEATURE_SIDE = 256
"""Frames are reduced to this longer side at most before features are computed, unless an extractor says otherwise."""

MOST_CHANNELS = {"densesift": 128, "aliked": 128, "dino": 768, "none": 0}
"""Channels of each kind of features, at most: smaller networks have fewer."""

FeatureMap = npt.NDArray[np.float32]


@runtime_checkable
class FeatureExtractor(Protocol):
    """Anything that describes every place of a frame."""

    channels: int
    """Length of a descriptor."""

    def __call__(self, frame: npt.NDArray[np.uint8]) -> FeatureMap:
        """Descriptors of unit norm of one frame [H, W, 3] RGB: [h, w, channels], a raster that covers the frame."""
        ...


def resized(frame: npt.NDArray[np.uint8], longer_side: int, multiple: int = 1) -> npt.NDArray[np.uint8]:
    """The frame with its longer side about `longer_side`, both sides multiples of `multiple`; never enlarged beyond
    the next multiple."""
    height, width = frame.shape[:2]
    scale = min(1.0, longer_side / max(height, width))
    size = tuple(max(multiple, multiple * round(side * scale / multiple)) for side in (width, height))
    return np.asarray(cv2.resize(frame, size, interpolation=cv2.INTER_AREA), np.uint8)

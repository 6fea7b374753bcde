"""Dense features to render: what a point looks like, more discriminatively than its colour."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
import torch
import torch.nn.functional as F

FEATURE_SIDE = 256
"""Frames are brought to this longer side before features are computed."""
PADDING = 6
"""Pixels of zeros around the frame's gradients, so that there is a descriptor at every pixel."""


def dense_sift(frame: npt.NDArray[np.uint8]) -> npt.NDArray[np.float32]:
    """kornia's dense SIFT of one frame [H, W, 3], reduced to `FEATURE_SIDE` first: [h, w, 128], unit norm."""
    from kornia.feature import DenseSIFTDescriptor

    height, width = frame.shape[:2]
    shrink = min(1.0, FEATURE_SIDE / max(height, width))
    size = (round(width * shrink), round(height * shrink))
    grey = cv2.cvtColor(cv2.resize(frame, size, interpolation=cv2.INTER_AREA), cv2.COLOR_RGB2GRAY)
    with torch.inference_mode():
        described = DenseSIFTDescriptor(padding=PADDING)(torch.from_numpy(grey).float()[None, None] / 255)
        # kornia's raster is centred on the frame's and larger: by one pixel here, with half a pixel on each side
        if (described.shape[-1] - size[0]) % 2:
            described = F.normalize(F.avg_pool2d(described, 2, stride=1), dim=1)
    margin = (described.shape[-1] - size[0]) // 2
    return described[0, :, margin : margin + size[1], margin : margin + size[0]].permute(1, 2, 0).numpy()


def reduce_features(features: npt.NDArray[np.float32], size: int) -> npt.NDArray[np.float32]:
    """PCA of [..., channel] to `size` channels (0: as they are), each vector then scaled to unit norm."""
    flat = features.reshape(-1, features.shape[-1])
    if 0 < size < flat.shape[-1]:
        subset = flat[:: max(1, len(flat) // 100_000)]
        mean = subset.mean(axis=0)
        _, vectors = np.linalg.eigh(np.cov(subset - mean, rowvar=False))
        flat = (flat - mean) @ vectors[:, ::-1][:, :size].astype(np.float32)
    norm = np.linalg.norm(flat, axis=-1, keepdims=True)
    return (flat / np.maximum(norm, 1e-6)).reshape(*features.shape[:-1], -1).astype(np.float32)

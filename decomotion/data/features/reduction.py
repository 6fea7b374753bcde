"""Reducing features to a few channels by PCA."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

SAMPLE = 100_000
"""About as many features at most decide the directions."""


@dataclass(frozen=True)
class Reduction:
    """A projection onto `vectors` about `mean`, each result then scaled to unit norm."""

    mean: npt.NDArray[np.float32]
    """[channel]"""
    vectors: npt.NDArray[np.float32] | None
    """[channel, size], orthonormal; None: the features as they are."""

    def __call__(self, features: npt.NDArray[np.floating]) -> npt.NDArray[np.float32]:
        """Features [..., channel] to [..., size], of unit norm; a blank one stays blank."""
        flat = np.asarray(features, np.float32)
        if self.vectors is not None:
            flat = (flat - self.mean) @ self.vectors
        norm = np.linalg.norm(flat, axis=-1, keepdims=True)
        return (flat / np.maximum(norm, 1e-6)).astype(np.float32)


def fit_reduction(features: npt.NDArray[np.floating], size: int) -> Reduction:
    """The PCA of features [..., channel] to `size` channels; 0, or as many as there are: none."""
    channels = features.shape[-1]
    flat = features.reshape(-1, channels)
    if not 0 < size < channels:
        return Reduction(np.zeros(channels, np.float32), None)
    sample = flat[:: max(1, len(flat) // SAMPLE)].astype(np.float32)
    mean = sample.mean(axis=0)
    sample = sample - mean
    _, vectors = np.linalg.eigh((sample.T @ sample).astype(np.float64))
    return Reduction(mean, np.ascontiguousarray(vectors[:, ::-1][:, :size], np.float32))

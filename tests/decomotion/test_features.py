"""Dense features and their reduction."""

from __future__ import annotations

import numpy as np
import pytest

from decomotion.data.features import FEATURE_SIDE, dense_sift, reduce_features


def random(*shape: int) -> np.ndarray:
    return np.random.default_rng(0).normal(size=shape).astype(np.float32)


def cosines(vectors: np.ndarray) -> np.ndarray:
    unit = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    return unit @ unit.T


@pytest.mark.parametrize(("size", "channels"), [(0, 12), (3, 3), (12, 12), (40, 12)])
def test_vectors_of_unit_norm_and_of_that_size(size: int, channels: int):
    reduced = reduce_features(random(2, 5, 6, 12), size)
    assert reduced.shape == (2, 5, 6, channels)
    assert reduced.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(reduced, axis=-1), 1, rtol=1e-5)


def test_zero_leaves_the_directions():
    features = random(30, 12)
    np.testing.assert_allclose(cosines(reduce_features(features, 0)), cosines(features), atol=1e-5)


def test_what_varies_in_few_directions_loses_nothing():
    """Features in a plane of 12 dimensions: their angles about the mean survive the reduction to 2."""
    features = random(60, 2) @ random(2, 12) + 5
    expected = cosines(features - features.mean(axis=0))
    np.testing.assert_allclose(cosines(reduce_features(features, 2)), expected, atol=1e-3)


def test_a_blank_feature_stays_blank():
    assert not reduce_features(np.zeros((2, 8), np.float32), 0).any()


@pytest.mark.parametrize(("height", "width"), [(33, 47), (40, 2 * FEATURE_SIDE)])
def test_dense_sift(height: int, width: int):
    frame = np.random.default_rng(0).integers(0, 256, (height, width, 3), dtype=np.uint8)
    described = dense_sift(frame)
    shrink = min(1, FEATURE_SIDE / width)
    assert described.shape == (round(height * shrink), round(width * shrink), 128)
    np.testing.assert_allclose(np.linalg.norm(described, axis=-1), 1, atol=1e-3)


@pytest.mark.parametrize("spot", [(20, 12), (44, 30), (33, 24)])
@pytest.mark.parametrize("enlarged", [1, 4])
def test_dense_sift_lies_where_the_image_does(spot: tuple[int, int], enlarged: int):
    """The descriptors that see a dot in a blank frame are centred on the dot."""
    small = np.zeros((48, 64, 3), np.uint8)
    small[spot[1], spot[0]] = 255
    frame = np.kron(small, np.ones((enlarged, enlarged, 1), np.uint8))
    described = dense_sift(frame)
    y, x = np.argwhere(np.abs(described - described[0, 0]).max(axis=-1) > 0.01).mean(axis=0)
    assert x == pytest.approx((spot[0] + 0.5) * enlarged - 0.5, abs=0.5)
    assert y == pytest.approx((spot[1] + 0.5) * enlarged - 0.5, abs=0.5)

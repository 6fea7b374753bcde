"""Look-ups at points: a map of another raster is read where the clip's pixels are."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from decomotion.data.sampling import MOST_POINTS, bilinear, nearest, sample_map


def test_maps_of_another_raster_are_read_where_the_clip_s_pixels_are():
    """A map at half the clip's resolution, whose values are its own x and y: clip pixel 0 lies at -0.25 in it."""
    y, x = np.mgrid[:8, :12].astype(np.float32)
    image = np.stack([x, y, x, y, x, y], axis=-1)
    xy = np.array([[2.5, 4.5], [3.0, 4.0], [20.0, 11.5]], np.float32)
    expected = np.tile((xy + 0.5) / 2 - 0.5, 3)
    np.testing.assert_allclose(sample_map(image, xy, 16, 24), expected, atol=1e-3)


@pytest.mark.parametrize("shape", [(9, 14, 3), (9, 14, 2), (9, 14)])
def test_more_points_than_a_row_of_opencv_s_may_have(shape: tuple[int, ...]):
    random = np.random.default_rng(0)
    image = random.random(shape, np.float32)
    xy = random.random((2, 2 * MOST_POINTS + 7, 2), np.float32) * 20 - 3
    found = bilinear(image, xy)
    assert found.shape == (*xy.shape[:-1], image[0, 0].size)
    for first in range(0, xy.shape[1], 20_000):
        part = xy[:, first : first + 20_000].copy()
        alone = cv2.remap(image, part, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)  # type: ignore[call-overload]
        np.testing.assert_array_equal(found[:, first : first + 20_000], alone.reshape(*part.shape[:-1], -1))


def test_look_up_is_bilinear_with_the_border_repeated():
    field = np.array([[[0, 1], [2, 3]], [[4, 5], [6, 7]]], np.float32)
    xy = np.array([[[0, 0], [0.5, 0], [0.5, 0.5]], [[1, 1], [-3, 0], [9, 9]]], np.float32)
    expected = [[[0, 1], [1, 2], [3, 4]], [[6, 7], [0, 1], [6, 7]]]
    np.testing.assert_allclose(bilinear(field, xy), expected, atol=1e-6)


def test_masks_are_read_at_the_nearest_pixel_with_the_border_repeated():
    mask = np.array([[False, True, False], [True, True, True]])
    xy = np.array([[[0.4, 0.4], [0.6, 0.4], [0.4, 0.6]], [[-5, 9], [9, -5], [2.4, 0.6]]], np.float32)
    np.testing.assert_array_equal(nearest(mask, xy), [[False, True, True], [True, False, True]])

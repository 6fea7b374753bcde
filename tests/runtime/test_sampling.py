from __future__ import annotations

import cv2
import numpy as np
import pytest

from decomo_runtime.sampling import known_median, sampled


def bilinear(image: np.ndarray, place: np.ndarray) -> np.ndarray:
    """One place inside the image, by hand."""
    x, y = place
    left, top = int(np.floor(x)), int(np.floor(y))
    across, down = x - left, y - top
    rows = image[top : top + 2, left : left + 2].astype(float)
    upper, lower = ((1 - across) * row[0] + across * row[1] for row in rows)
    return (1 - down) * upper + down * lower


@pytest.mark.parametrize("shape", [(), (7,), (3, 5), (2, 0)])
@pytest.mark.parametrize("channels", [(), (3,)])
def test_bilinear_as_by_hand(shape: tuple[int, ...], channels: tuple[int, ...]):
    random = np.random.default_rng(0)
    image = random.uniform(0, 255, (11, 17, *channels)).astype(np.float32)
    places = random.integers(0, 9 * 32, (*shape, 2)).astype(np.float32) / 32  # OpenCV reads at every 32nd of a pixel
    read = sampled(image, places)
    assert read.shape == (*shape, *channels)
    expected = [bilinear(image, place) for place in places.reshape(-1, 2)]
    np.testing.assert_allclose(read, np.reshape(expected, read.shape), rtol=1e-5)


def test_more_places_than_a_short_counts():
    image = np.arange(40, dtype=np.float32).reshape(5, 8)
    places = np.tile(np.stack(np.meshgrid(np.arange(8), np.arange(5)), axis=-1).reshape(-1, 2), (2000, 1))
    np.testing.assert_array_equal(sampled(image, places), np.tile(np.arange(40), 2000))


def test_beyond_the_borders():
    image = np.full((4, 6), 9, np.uint8)
    image[:, -1] = 7
    places = np.array([[9.0, 1.0], [5.0, -3.0], [2.0, 2.0]])
    np.testing.assert_array_equal(sampled(image, places), [7, 7, 9])
    np.testing.assert_array_equal(sampled(image, places, cv2.INTER_CUBIC, outside=1), [1, 1, 9])


def test_the_median_of_what_is_known():
    random = np.random.default_rng(0)
    values = random.normal(size=(6, 40, 3)).astype(np.float32)
    values[random.uniform(size=values.shape) < 0.5] = np.nan
    values[0] = 1  # something is known everywhere
    np.testing.assert_array_equal(known_median(values), np.nanmedian(values, axis=0))
    values[:, 4] = np.nan
    assert np.isnan(known_median(values)[4]).all()
    assert np.isfinite(known_median(values)[5]).all()
    assert known_median(values[:, :0]).shape == (0, 3)

from __future__ import annotations

import numpy as np
import pytest

from decomo_runtime.mipmaps import Mipmaps


def chequers(height: int, width: int) -> np.ndarray:
    """Of single pixels, black and white, opaque."""
    row, column = np.indices((height, width))
    grey = 255 * ((row + column) % 2)
    return np.dstack([grey, grey, grey, np.full_like(grey, 255)]).astype(np.uint8)


def places(height: int, width: int, step: float = 1.0) -> np.ndarray:
    x, y = np.meshgrid(np.arange(0, width, step), np.arange(0, height, step))
    return np.column_stack([x.ravel(), y.ravel()]).astype(np.float32)


def test_at_its_own_scale_it_is_the_picture():
    picture = np.random.default_rng(0).integers(0, 256, (21, 34, 4), np.uint8)
    read = Mipmaps(picture).read(places(21, 34), np.ones(21 * 34, np.float32))
    np.testing.assert_allclose(read[:, 3], picture[..., 3].ravel() / 255, atol=1e-5)
    premultiplied = picture[..., :3] / 255 * (picture[..., 3:] / 255)
    np.testing.assert_allclose(read[:, :3], premultiplied.reshape(-1, 3), atol=1e-5)


@pytest.mark.parametrize("scale", [4.0, 7.3, 500.0])
def test_no_aliases_where_it_is_read_small(scale: float):
    at = places(24, 60, 3)
    read = Mipmaps(chequers(24, 60)).read(at, np.full(len(at), scale, np.float32))
    np.testing.assert_allclose(read[:, :3], 0.5, atol=0.02)
    np.testing.assert_allclose(read[:, 3], 1, atol=1e-5)


def test_outside_it_is_transparent():
    at = np.array([[-0.6, 3], [33.6, 3], [5, -0.6], [5, 20.6], [-0.4, 3], [33.4, 20.4]], np.float32)
    read = Mipmaps(chequers(21, 34)).read(at, np.full(6, 1.5, np.float32))
    np.testing.assert_allclose(read[:, 3], [0, 0, 0, 0, 1, 1], atol=1e-5)


def test_colours_beneath_what_is_transparent_do_not_show():
    picture = np.zeros((16, 16, 4), np.uint8)
    picture[..., 0] = 255  # red, without alpha
    picture[:, 8:] = (0, 0, 255, 255)
    at = np.array([[7.5, 8]], np.float32)
    assert Mipmaps(picture).read(at, np.array([2], np.float32))[0, 0] == 0


def test_no_colour_is_brighter_than_its_alpha_lets_through():
    """Between pixels cubic interpolation overshoots, of colours and of alpha by different amounts."""
    picture = np.random.default_rng(1).integers(0, 2, (21, 34, 4), np.uint8) * 255
    at = places(21, 34, 0.37)
    read = Mipmaps(picture).read(at, np.ones(len(at), np.float32))
    assert (read[:, :3] <= read[:, 3:]).all()
    assert ((read >= 0) & (read <= 1)).all()

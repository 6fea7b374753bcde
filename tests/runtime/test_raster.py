from __future__ import annotations

import numpy as np

from decomo_runtime.raster import Raster, around, whole


def test_around_a_mask():
    mask = np.zeros((9, 14), bool)
    assert around(mask) is None
    mask[3, 5] = mask[6, 2] = True
    assert around(mask) == Raster((9, 14), slice(3, 7), slice(2, 6))
    assert whole((9, 14)).shape == mask[whole((9, 14)).part].shape == (9, 14)


def test_grown_ends_at_the_borders():
    assert Raster((9, 14), slice(3, 7), slice(2, 6)).grown(3) == Raster((9, 14), slice(0, 9), slice(0, 9))


def test_scaled_holds_all_of_it():
    scaled = Raster((9, 14), slice(3, 7), slice(2, 6)).scaled((480, 854))
    assert scaled == Raster((480, 854), slice(160, 374), slice(122, 366))
    assert scaled.shape == (214, 244)
    assert whole((7, 5)).scaled((3, 4)) == whole((3, 4))
    assert Raster((480, 854), slice(161, 162), slice(0, 1)).scaled((9, 14)) == Raster((9, 14), slice(3, 4), slice(0, 1))

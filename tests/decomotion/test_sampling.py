"""Look-ups at points: a map of another raster is read where the clip's pixels are."""

from __future__ import annotations

import numpy as np

from decomotion.data.sampling import sample_map


def test_maps_of_another_raster_are_read_where_the_clip_s_pixels_are():
    """A map at half the clip's resolution, whose values are its own x and y: clip pixel 0 lies at -0.25 in it."""
    y, x = np.mgrid[:8, :12].astype(np.float32)
    image = np.stack([x, y, x, y, x, y], axis=-1)
    xy = np.array([[2.5, 4.5], [3.0, 4.0], [20.0, 11.5]], np.float32)
    expected = np.tile((xy + 0.5) / 2 - 0.5, 3)
    np.testing.assert_allclose(sample_map(image, xy, 16, 24), expected, atol=1e-3)

"""Deformation gradients by least squares, beside a plain twin."""

from __future__ import annotations

import numpy as np

from decomo_runtime.measure.gradient import gradients_of_points, gradients_of_raster

STEP = np.array([3.0, 2.0])
RADIUS = 2, 3


def raster(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places, displacements of no regular kind, and which nodes count."""
    rng = np.random.default_rng(seed)
    row, column = np.mgrid[0:14, 0:19]
    places = np.stack([column, row], axis=-1) * STEP
    return places, rng.normal(size=places.shape), rng.random(row.shape) < 0.6


def test_a_raster_is_what_numpy_fits_around_each_node():
    places, moved, counted = raster(0)
    found = gradients_of_raster(np.where(counted[..., None], moved, np.nan), STEP, RADIUS, counted)
    known = 0
    for row, column in np.ndindex(counted.shape):
        rows = slice(max(0, row - RADIUS[1]), row + RADIUS[1] + 1)
        columns = slice(max(0, column - RADIUS[0]), column + RADIUS[0] + 1)
        mine = counted[rows, columns]
        if mine.sum() < 0.3 * 35:
            assert np.isnan(found.deformation[row, column]).all()
            assert np.isnan(found.residual[row, column])
            continue
        design = np.column_stack([np.ones(mine.sum()), places[rows, columns][mine]])
        here = moved[rows, columns][mine]
        slope = np.linalg.lstsq(design, here, rcond=None)[0]
        np.testing.assert_allclose(found.deformation[row, column], np.eye(2) + slope[1:].T, atol=1e-9)
        left = np.sqrt(((here - design @ slope) ** 2).sum(1).mean())
        np.testing.assert_allclose(found.residual[row, column], left, atol=1e-6)
        known += 1
    assert 100 < known < counted.size


def test_points_are_fitted_alike():
    places, moved, counted = raster(1)
    start, there = places.reshape(-1, 2), (places + moved).reshape(-1, 1, 2)
    both = np.stack([counted.reshape(-1), np.ones(counted.size, bool)], axis=1)
    found = gradients_of_points(start, np.repeat(there, 2, axis=1), both)
    for frame, mine in enumerate(both.T):
        design = np.column_stack([np.ones(mine.sum()), start[mine] - start.mean(0)])
        slope = np.linalg.lstsq(design, moved.reshape(-1, 2)[mine], rcond=None)[0]
        np.testing.assert_allclose(found.deformation[frame], np.eye(2) + slope[1:].T, atol=1e-9)
        np.testing.assert_allclose(found.moved[frame], slope[0], atol=1e-9)
        left = moved.reshape(-1, 2)[mine] - design @ slope
        np.testing.assert_allclose(found.residual[frame], np.sqrt((left**2).sum(1).mean()))


def test_points_on_a_line_have_no_gradient():
    line = np.stack([np.arange(9.0), 2 * np.arange(9.0)], axis=-1)
    found = gradients_of_points(line, line[:, None], np.ones((9, 1), bool))
    assert np.isnan(found.deformation).all()
    few = np.array([[0, 0], [1, 0], [0, 1]], float)
    assert np.isnan(gradients_of_points(few, few[:, None], np.ones((3, 1), bool)).deformation).all()


def test_points_must_spread_by_a_thousandth_of_their_line():
    for across, told in ((0.02, True), (0.0005, False)):
        points = np.stack([np.linspace(-1, 1, 21), across * np.tile([1, -1, 0], 7)], axis=-1)
        found = gradients_of_points(points, points[:, None] * (1.1, 2), np.ones((21, 1), bool))
        assert np.isfinite(found.deformation).all() == told

"""Where the pool's points are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from decomotion.data.pool import Pool, grid_shape, jittered_grid, open_pool

SIZES = [(48, 64, 192), (64, 48, 192), (33, 57, 100), (32, 32, 256)]


@pytest.mark.parametrize(("height", "width", "count"), SIZES)
def test_one_point_in_each_cell(height: int, width: int, count: int):
    rows, columns = grid_shape(height, width, count)
    points = jittered_grid(3, height, width, count, np.random.default_rng(0)).reshape(3, rows, columns, 2)
    cell = (points + 0.5) / (width / columns, height / rows)
    expected_y, expected_x = np.mgrid[:rows, :columns]
    assert (np.floor(cell[..., 0]) == expected_x).all()
    assert (np.floor(cell[..., 1]) == expected_y).all()


@pytest.mark.parametrize(("height", "width", "count"), SIZES)
def test_cells_are_nearly_square_and_about_as_many_as_asked_for(height: int, width: int, count: int):
    rows, columns = grid_shape(height, width, count)
    assert rows * columns == pytest.approx(count, rel=0.1)
    assert (width / columns) / (height / rows) == pytest.approx(1, rel=0.2)


def test_points_lie_between_the_outermost_pixel_centres():
    points = jittered_grid(20, 4, 5, 20, np.random.default_rng(0))
    assert points.min() == 0
    assert points[..., 0].max() <= 4
    assert points[..., 1].max() <= 3


def test_frames_have_points_of_their_own():
    first, second = jittered_grid(2, 48, 64, 192, np.random.default_rng(0))
    assert (first != second).any(axis=-1).all()


def test_a_pool_is_opened_without_loading_it(tmp_path: Path):
    types = {"confidence": np.uint8, "rgb": np.uint8, "moving": np.uint8, "feature": np.float16}
    for name in Pool.__dataclass_fields__:
        np.save(tmp_path / f"{name}.npy", np.zeros((2, 3, 4), types.get(name, np.float32)))
    pool = open_pool(tmp_path)
    assert (pool.num_frames, pool.num_points, pool.feature_size) == (2, 3, 4)
    assert all(isinstance(getattr(pool, name), np.memmap) for name in Pool.__dataclass_fields__)

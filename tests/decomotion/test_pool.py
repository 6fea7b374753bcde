"""Where the pool's points are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from decomotion.data.pool import Pool, affordable_points, grid_shape, jittered_grid, open_pool
from decomotion.data.positions import PackedPositions, first_points, pack

ARRAYS = [name for name in Pool.__dataclass_fields__ if name not in ("longer_side", "structure", "thinned")]
TYPES = {"confidence": np.uint8, "rgb": np.uint8, "moving": np.uint8, "feature": np.float16, "targets": np.uint16}
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
    assert points.min(axis=(0, 1)).tolist() == [0, 0]  # what is drawn on the outer half of a border pixel is moved
    assert points.max(axis=(0, 1)).tolist() == [4, 3]


def test_frames_have_points_of_their_own():
    first, second = jittered_grid(2, 48, 64, 192, np.random.default_rng(0))
    assert (first != second).any(axis=-1).all()


def test_a_pool_is_opened_without_loading_it(tmp_path: Path):
    for name in ARRAYS:
        folder = tmp_path / ("one" if name < "f" else "other")
        folder.mkdir(exist_ok=True)
        np.save(folder / f"{name}.npy", np.zeros((2, 3, 4), TYPES.get(name, np.float32)))
    pool = open_pool([tmp_path / "one", tmp_path / "other"], longer_side=100)
    assert (pool.num_frames, pool.num_points, pool.feature_size, pool.longer_side) == (2, 3, 4, 100)
    assert all(isinstance(getattr(pool, name), np.memmap) for name in ARRAYS if name != "targets")
    assert isinstance(pool.targets, PackedPositions)


def test_a_later_folder_s_array_takes_an_earlier_one_s_place(tmp_path: Path):
    for number, folder in enumerate((tmp_path / "links", tmp_path / "filter")):
        folder.mkdir()
        for name in ARRAYS if number == 0 else ["confidence"]:
            np.save(folder / f"{name}.npy", np.full((2, 3, 4), number, TYPES.get(name, np.float32)))
    pool = open_pool([tmp_path / "links", tmp_path / "filter"], longer_side=100)
    assert (pool.confidence == 1).all()
    assert (pool.moving == 0).all()


class TestPacking:
    @pytest.mark.parametrize("side", [32, 256, 854])
    def test_positions_survive_to_a_small_part_of_a_pixel(self, side: int):
        xy = np.random.default_rng(0).uniform(-side, 2 * side, (5, 6, 7, 2)).astype(np.float32)
        unpacked = PackedPositions(pack(xy, side), side)
        assert unpacked.shape == xy.shape
        assert np.abs(unpacked[...] - xy).max() < 0.0061 * side / 256
        assert unpacked[...].dtype == np.float32

    def test_what_lies_far_outside_stays_outside(self):
        xy = np.array([[-1e6, 0.0], [1e6, np.float32(np.inf)]], np.float32)
        np.testing.assert_allclose(PackedPositions(pack(xy, 100), 100)[...], [[-100, 0], [200, 200]], atol=1e-2)

    def test_indexed_as_an_array(self):
        xy = np.random.default_rng(0).uniform(0, 64, (4, 4, 9, 2)).astype(np.float32)
        unpacked = PackedPositions(pack(xy, 64), 64)
        frame, target, point = np.array([[0], [3]]), np.array([[1], [2]]), np.array([[5, 6], [7, 8]])
        np.testing.assert_allclose(unpacked[frame, target, point], xy[frame, target, point], atol=2e-3)
        np.testing.assert_allclose(unpacked.first_points(3)[1], xy[1, :, :3], atol=2e-3)
        np.testing.assert_allclose(np.asarray(unpacked), xy, atol=2e-3)

    @pytest.mark.parametrize("side", [40, 300])
    def test_the_first_points_of_each_frame(self, side: int):
        """Of arrays and of what is packed, at any size of a frame."""
        xy = np.random.default_rng(0).uniform(0, side, (4, 5, 9, 2)).astype(np.float32)
        given = first_points(PackedPositions(pack(xy, side), side), 3)
        assert given.shape == (4, 5, 3, 2)
        np.testing.assert_allclose(given[...], xy[:, :, :3], atol=0.0061 * side / 256)
        np.testing.assert_array_equal(first_points(xy, 3), xy[:, :, :3])


@pytest.mark.parametrize("filtered", [False, True])
@pytest.mark.parametrize(("frames", "channels"), [(32, 16), (100, 16), (100, 768), (300, 0)])
def test_affordable_points_fill_the_limit(frames: int, channels: int, filtered: bool):
    points = affordable_points(frames, channels, 1024, filtered)
    position, confidence, colour, mask, structure = 4, 1 + filtered, 3, 1, 12 + 36 + 4
    size = frames * points * (frames * (position + confidence) + 8 + colour + mask + structure + 2 * channels)
    assert size == pytest.approx(2**30, rel=1e-3)
    assert size <= 2**30

"""Motion masks: what moves is found, and what does not fit the clip is named."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from decomotion.data.masks import moving_from_residual, read_masks, residual_motion
from decomotion.data.pool import grid_shape, jittered_grid
from decomotion.errors import SupervisionError

FRAMES, HEIGHT, WIDTH, COUNT = 6, 96, 128, 768
UNIT = WIDTH / 256


def square(frame: int) -> tuple[slice, slice]:
    """Rows and columns of a square that moves to the right."""
    return slice(30, 62), slice(20 + 5 * frame, 52 + 5 * frame)


def scene() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, their targets and their truth: a camera that zooms and pans, a square that moves on its own."""
    points = jittered_grid(FRAMES, HEIGHT, WIDTH, COUNT, np.random.default_rng(0))
    moving = np.zeros((FRAMES, points.shape[1]), np.bool_)
    targets = np.empty((FRAMES, FRAMES, points.shape[1], 2), np.float32)
    for i in range(FRAMES):
        rows, columns = square(i)
        x, y = points[i].T
        moving[i] = (y > rows.start) & (y < rows.stop) & (x > columns.start) & (x < columns.stop)
        for j in range(FRAMES):
            camera = (points[i] - (64, 48)) * 1.01 ** (j - i) + (64, 48) + np.array([-1.0, 0.5]) * (j - i)
            targets[i, j] = np.where(moving[i, :, None], points[i] + np.array([5.0, 0.0]) * (j - i), camera)
    return points, targets, moving


def test_residuals_are_large_on_what_moves_and_nowhere_else():
    points, targets, moving = scene()
    confidence = np.full(targets.shape[:3], 255, np.uint8)
    residual = residual_motion(points, targets, confidence, UNIT)
    assert residual[moving].min() > 3
    assert residual[~moving].max() < 0.1


def test_hidden_correspondences_say_nothing():
    points, targets, moving = scene()
    confidence = (255 * (np.random.default_rng(1).random(targets.shape[:3]) < 0.6)).astype(np.uint8)
    confidence[:, :, 7] = 0
    targets[confidence == 0] = 1e3
    residual = residual_motion(points, targets, confidence, UNIT)
    assert residual[:, 7].tolist() == [0] * FRAMES
    seen = (confidence.sum(axis=1) > 0) & ~moving
    assert residual[seen].max() < 0.1


def test_pairs_with_few_correspondences_say_nothing():
    points, targets, _ = scene()
    confidence = np.zeros(targets.shape[:3], np.uint8)
    confidence[..., :10] = 255
    assert not residual_motion(points, targets, confidence, UNIT).any()


def test_masks_cover_the_square():
    points, targets, _ = scene()
    residual = residual_motion(points, targets, np.full(targets.shape[:3], 255, np.uint8), UNIT)
    masks = moving_from_residual(residual, grid_shape(HEIGHT, WIDTH, COUNT), HEIGHT, WIDTH)
    assert masks.shape == (FRAMES, HEIGHT, WIDTH)
    for frame, mask in enumerate(masks):
        truth = np.zeros((HEIGHT, WIDTH), np.bool_)
        truth[square(frame)] = True
        # the grid's cells are 4 pixels
        assert (mask & truth).sum() / (mask | truth).sum() > 0.7


def test_where_nothing_moves_masks_are_empty():
    assert not moving_from_residual(np.zeros((2, 768), np.float32), (24, 32), HEIGHT, WIDTH).any()


def write(folder: Path, masks: dict[str, np.ndarray]) -> Path:
    folder.mkdir(exist_ok=True)
    for name, mask in masks.items():
        cv2.imwrite(str(folder / name), mask)
    return folder


def blank(*spots: tuple[int, int], height: int = 4, width: int = 6) -> np.ndarray:
    mask = np.zeros((height, width, 3), np.uint8)
    for spot in spots:
        mask[spot] = (0, 0, 7)
    return mask


class TestRead:
    def test_any_pixel_that_is_not_black_moves(self, tmp_path: Path):
        masks = read_masks(write(tmp_path, {"0.png": blank((1, 2)), "1.png": blank()}), 2, 4, 6)
        assert masks.dtype == np.bool_
        assert np.argwhere(masks).tolist() == [[0, 1, 2]]

    def test_natural_order(self, tmp_path: Path):
        names = ("frame10.png", "frame9.png", "frame1.png")
        write(tmp_path, {name: blank((0, index)) for index, name in enumerate(names)})
        assert np.argwhere(read_masks(tmp_path, 3, 4, 6))[:, 2].tolist() == [2, 1, 0]

    def test_names_that_clips_may_have_too(self, tmp_path: Path):
        write(tmp_path, {"2²1.png": blank((0, 0)), "2²2.png": blank((0, 1))})
        (tmp_path / "._2²1.png").write_bytes(b"what macOS leaves beside a copied file")
        assert np.argwhere(read_masks(tmp_path, 2, 4, 6))[:, 2].tolist() == [0, 1]

    def test_grey_images(self, tmp_path: Path):
        write(tmp_path, {"0.png": blank((3, 5)).max(axis=-1)})
        assert read_masks(tmp_path, 1, 4, 6).sum() == 1

    def test_absent(self, tmp_path: Path):
        with pytest.raises(SupervisionError, match="nowhere does not exist"):
            read_masks(tmp_path / "nowhere", 2, 4, 6)

    def test_another_number(self, tmp_path: Path):
        with pytest.raises(SupervisionError, match="has 1 images but the clip has 2 frames"):
            read_masks(write(tmp_path, {"0.png": blank()}), 2, 4, 6)

    def test_another_size_is_named(self, tmp_path: Path):
        write(tmp_path, {"0.png": blank(), "1.png": blank(height=5)})
        with pytest.raises(SupervisionError, match=r"1\.png is 6x5 but the clip is 6x4"):
            read_masks(tmp_path, 2, 4, 6)

    def test_undecodable_is_named(self, tmp_path: Path):
        write(tmp_path, {"0.png": blank()})
        (tmp_path / "1.png").write_bytes(b"no image")
        with pytest.raises(SupervisionError, match=r"1\.png does not decode"):
            read_masks(tmp_path, 2, 4, 6)

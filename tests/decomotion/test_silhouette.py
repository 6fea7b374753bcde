"""Silhouettes: limbs whose links follow the scene are found, and the scene is not taken for them."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from decomotion.data.masks.links import Links
from decomotion.data.masks.scene import LEAST, difference
from decomotion.data.masks.silhouette import Mask, silhouette, silhouettes
from decomotion.data.pool import grid_shape, jittered_grid

FRAMES, HEIGHT, WIDTH, POINTS = 12, 72, 128, 2304
"""A unit is half a pixel."""
PAN = np.float32([1.5, 0.5])
"""Of the scene, pixels a frame."""


def body(frame: int) -> Mask:
    mask = np.zeros((HEIGHT, WIDTH), np.bool_)
    mask[20:40, 90 - 5 * frame : 110 - 5 * frame] = True
    return mask


def limb(frame: int) -> Mask:
    """Two pixels wide, under the body."""
    mask = np.zeros((HEIGHT, WIDTH), np.bool_)
    mask[40:47, 98 - 5 * frame : 100 - 5 * frame] = True
    return mask


def box(rows: slice, columns: slice, shape: tuple[int, int] = (144, 256)) -> Mask:
    mask = np.zeros(shape, np.bool_)
    mask[rows, columns] = True
    return mask


def at(mask: Mask, xy: np.ndarray) -> np.ndarray:
    x, y = np.round(xy).astype(int).T
    return mask[y.clip(0, mask.shape[0] - 1), x.clip(0, mask.shape[1] - 1)]


@pytest.fixture(scope="module")
def filmed() -> tuple[np.ndarray, np.ndarray, Links]:
    """Frames, the probability that points move, which knows of the body alone, and links of all else with the scene."""
    random = np.random.default_rng(3)
    texture = cv2.GaussianBlur(random.uniform(0, 255, (HEIGHT + 40, WIDTH + 40, 3)), (0, 0), 1.5)
    texture = np.clip(128 + 3 * (texture - 128), 0, 255).astype(np.float32)
    frames = []
    for frame in range(FRAMES):
        x, y = 20 - PAN * frame
        view = cv2.warpAffine(texture, np.float32([[1, 0, -x], [0, 1, -y]]), (WIDTH, HEIGHT))  # type: ignore[arg-type]
        view[body(frame) | limb(frame)] = (240, 20, 20)
        frames.append(view.astype(np.uint8))
    points = jittered_grid(FRAMES, HEIGHT, WIDTH, POINTS, random)
    away = np.arange(FRAMES)[None] - np.arange(FRAMES)[:, None]
    moves = np.stack([at(body(frame), xy) for frame, xy in enumerate(points)])
    speed = np.where(moves[..., None], np.float32([-5, 0]), PAN)
    targets = points[:, None] + away[..., None, None].astype(np.float32) * speed[:, None]
    inside = ((targets > 0) & (targets < np.float32([WIDTH - 1, HEIGHT - 1]))).all(axis=-1)
    grid = grid_shape(HEIGHT, WIDTH, POINTS)
    links = Links(points, targets, (255 * inside).astype(np.uint8), grid, (HEIGHT, WIDTH))
    return np.stack(frames), moves.astype(np.float32).reshape(FRAMES, *grid), links


def test_a_limb_that_its_links_give_to_the_scene_is_found(filmed: tuple[np.ndarray, np.ndarray, Links]) -> None:
    frames, probability, links = filmed
    found = list(silhouettes(frames, probability, links, np.random.default_rng(0)))
    assert len(found) == FRAMES
    for frame, mask in enumerate(found):
        assert mask.shape == (144, 256)
        truth = (body(frame) | limb(frame)).repeat(2, axis=0).repeat(2, axis=1)
        of_limb = limb(frame).repeat(2, axis=0).repeat(2, axis=1)
        assert mask[of_limb].mean() > 0.95
        assert mask[truth].mean() > 0.97
        around = cv2.dilate(truth.view(np.uint8), np.ones((9, 9), np.uint8)) > 0
        assert mask[~around].mean() < 0.002


def test_without_another_frame_the_mask_stays(filmed: tuple[np.ndarray, np.ndarray, Links]) -> None:
    """Where what moves has covered a place in all frames, nothing tells of the scene there."""
    frames, probability, links = filmed
    sides = (HEIGHT, WIDTH)
    alone = Links(links.points[:1] / 2, links.points[:1, None] / 2, np.zeros((1, 1, 2304), np.uint8), links.grid, sides)
    (mask,) = silhouettes(frames[:1], probability[:1], alone, np.random.default_rng(0))
    truth = body(0).repeat(2, axis=0).repeat(2, axis=1)
    assert (mask & truth).sum() / (mask | truth).sum() > 0.8


@pytest.mark.parametrize(("share", "moves"), [(0.0, True), (0.05, True), (0.2, False), (1.0, False)])
def test_what_moves_differs_more_than_the_scene_around_does(share: float, moves: bool) -> None:
    """A stripe 4 units beside the mask that is 20 grey levels off, before a scene that in a share of it is 30 off."""
    mask, different = box(slice(60, 80), slice(100, 120)), np.full((144, 256), 2, np.float32)
    different[np.random.default_rng(0).random(different.shape) < share] = 30
    near = box(slice(44, 96), slice(84, 136))
    different[near] = 0
    stripe = box(slice(62, 78), slice(124, 128))
    different[stripe] = LEAST + 8
    found = silhouette(mask, different)
    assert found[stripe].all() == moves
    assert found[62:78, 102:118].all()
    assert not found[:40].any()


def test_the_rim_of_a_mask_that_looks_like_the_scene_is_the_scene() -> None:
    """And stays where the scene is not known."""
    mask, different = box(slice(60, 80), slice(100, 120)), np.zeros((144, 256), np.float32)
    np.testing.assert_array_equal(silhouette(mask, different)[70], box(slice(0, 144), slice(101, 119))[70])
    different[:, :110] = np.nan
    np.testing.assert_array_equal(silhouette(mask, different)[70], box(slice(0, 144), slice(99, 119))[70])


def test_far_from_a_mask_nothing_moves() -> None:
    mask, different = box(slice(60, 80), slice(100, 120)), np.zeros((144, 256), np.float32)
    different[66:74, 140:150] = 200  # 21 units away
    assert not silhouette(mask, different)[:, 138:].any()
    different[66:74, 128:134] = 200
    assert silhouette(mask, different)[68:72, 129:133].all()


def test_the_scene_is_the_median_of_its_views_and_may_lie_a_pixel_off() -> None:
    random = np.random.default_rng(0)
    scene = random.uniform(0, 255, (20, 30, 3)).astype(np.float32)
    views = [np.full_like(scene, 255), *(np.roll(scene, (1, -1), (0, 1)) for _ in range(2))]
    image = scene.copy()
    image[5:9, 10:14] = 255 - image[5:9, 10:14]
    found = difference(image.astype(np.uint8), views)
    assert found[6:8, 11:13].min() > 30
    assert np.delete(found[:, 2:-2], np.s_[3:11], axis=0)[2:-2].max() < 1
    views = [np.where(box(slice(0, 20), slice(0, 7), (20, 30))[..., None], np.float32(np.nan), view) for view in views]
    np.testing.assert_array_equal(np.isnan(difference(image.astype(np.uint8), views))[10], np.arange(30) < 7)
    assert np.isnan(difference(image.astype(np.uint8), [])).all()


@pytest.mark.parametrize(("levels", "moves"), [(11, False), (13, True)])
def test_what_moves_differs_by_twelve_grey_levels(levels: float, moves: bool) -> None:
    mask, different = box(slice(60, 80), slice(100, 120)), np.zeros((144, 256), np.float32)
    different[62:78, 124:128] = levels
    assert silhouette(mask, different)[64:76, 125:127].all() == moves


def test_what_is_narrower_than_three_units_is_noise() -> None:
    mask, different = box(slice(60, 80), slice(100, 120)), np.zeros((144, 256), np.float32)
    different[70, 124:132] = different[62:66, 126] = 200
    assert not silhouette(mask, different)[:, 122:].any()
    different[68:71, 124:132] = 200
    assert silhouette(mask, different)[69, 125:131].all()


def test_a_difference_is_the_mean_of_channels_and_of_nine_pixels() -> None:
    """Of 27, 0 and 0 levels at one pixel: 1 in each of nine. Of five views the brightest and the darkest are wrong."""
    scene = np.full((20, 30, 3), 100, np.float32)
    image = scene.astype(np.uint8)
    image[9, 12, 2] += 27
    views = [scene, np.zeros_like(scene), scene, np.full_like(scene, 255), scene]
    expected = np.zeros((20, 30))
    expected[8:11, 11:14] = 1
    np.testing.assert_allclose(difference(image, views), expected, atol=1e-5)

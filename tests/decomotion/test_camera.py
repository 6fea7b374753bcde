"""Closed-form motion: affine chains recovered from correspondences."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
import torch

from decomotion.data.camera import Affine, chain, compose, fit_affine, homogeneous, invert, shift, to_normalised
from decomotion.geometry import ImagePlane

FRAMES, POINTS, HEIGHT, WIDTH = 7, 100, 60, 90
UNIT = WIDTH / 256
EVERY = np.ones((FRAMES, POINTS), np.bool_)


def apply(matrix: Affine, xy: npt.NDArray) -> npt.NDArray:
    return xy @ matrix[:, :2].T + matrix[:, 2]


def similarity(frame: int) -> Affine:
    """To the world: a turn, a zoom and a pan that grow with time."""
    turn, zoom = 0.02 * frame, 1 + 0.01 * frame
    c, s = zoom * np.cos(turn), zoom * np.sin(turn)
    return np.array([[c, -s, 3.0 * frame], [s, c, -1.0 * frame]])


def sheared(frame: int) -> Affine:
    return similarity(frame) + 0.01 * frame * np.array([[0.5, 1.0, 0.0], [-0.2, -0.7, 0.0]])


def correspondences(world: list[Affine], outliers: float = 0.0) -> tuple[npt.NDArray, npt.NDArray]:
    random = np.random.default_rng(0)
    points = random.uniform((0, 0), (WIDTH, HEIGHT), (FRAMES, POINTS, 2)).astype(np.float32)
    targets = np.stack([[apply(compose(invert(b), a), p) for b in world] for a, p in zip(world, points, strict=True)])
    wrong = random.random(targets.shape[:3]) < outliers
    targets[wrong] += random.uniform(-30, 30, (wrong.sum(), 2))
    return points, targets.astype(np.float32)


@pytest.mark.parametrize("outliers", [0.0, 0.3])
@pytest.mark.parametrize("motion", [similarity, sheared])
def test_a_chain_of_affine_maps_is_recovered(motion, outliers: float):
    world = [motion(frame) for frame in range(FRAMES)]
    points, targets = correspondences(world, outliers)
    usable = np.ones(targets.shape[:3], np.uint8)
    maps = chain(points, targets, usable, EVERY, UNIT, similarity=motion is similarity)
    corners = np.array([[0.0, 0.0], [WIDTH, 0.0], [0.0, HEIGHT], [WIDTH, HEIGHT]])
    for frame in range(FRAMES):
        to_middle = compose(invert(world[FRAMES // 2]), world[frame])
        # exact but for float32 correspondences, and for the outliers that happen to lie within RANSAC's threshold
        tolerance = 0.3 if outliers else 1e-3
        np.testing.assert_allclose(apply(maps[frame], corners), apply(to_middle, corners), atol=tolerance)


def test_unusable_correspondences_are_not_looked_at():
    world = [similarity(frame) for frame in range(FRAMES)]
    points, targets = correspondences(world)
    random = np.random.default_rng(1)
    confidence, counted = random.integers(0, 2, targets.shape[:3], np.uint8), random.random((FRAMES, POINTS)) < 0.8
    targets[(confidence == 0) | ~counted[:, None]] = np.nan
    maps = chain(points, targets, confidence, counted, UNIT)
    np.testing.assert_allclose(maps[0], compose(invert(world[FRAMES // 2]), world[0]), atol=1e-3)


def test_the_middle_frame_stays():
    world = [sheared(frame) for frame in range(FRAMES)]
    points, targets = correspondences(world)
    maps = chain(points, targets, np.ones(targets.shape[:3], np.uint8), EVERY, UNIT)
    np.testing.assert_array_equal(maps[FRAMES // 2], np.eye(2, 3))


def test_few_points_give_a_shift_and_none_nothing():
    source = np.random.default_rng(0).uniform(0, 50, (5, 2)).astype(np.float32)
    target = source + np.array([2, -3], np.float32)
    target[0] += 40
    assert fit_affine(source, target, UNIT) is None
    found = shift(source, target)
    assert found is not None
    np.testing.assert_allclose(found, [[1, 0, 2], [0, 1, -3]], atol=1e-5)
    assert shift(source[:0], target[:0]) is None


def test_points_that_agree_on_nothing_tell_of_nothing():
    source, target = np.random.default_rng(0).uniform(0, 50, (2, 400, 2)).astype(np.float32)
    assert fit_affine(source, target, UNIT, least=40) is None
    assert fit_affine(source, source + np.float32(3), UNIT, least=40) is not None


@pytest.mark.parametrize("unseen", [[2], [3], [4, 5], [2, 3, 4]])
def test_frames_that_show_nothing_are_interpolated_and_those_behind_them_found(unseen: list[int]):
    """Also where the middle frame is one of them; the world moves steadily."""
    world = [np.array([[1, 0, 4.0 * frame], [0, 1, -2.0 * frame]]) for frame in range(FRAMES)]
    points, targets = correspondences(world)
    usable = np.ones(targets.shape[:3], np.uint8)
    usable[unseen], usable[:, unseen] = 0, 0
    maps = chain(points, targets, usable, EVERY, UNIT)
    for frame in range(FRAMES):
        np.testing.assert_allclose(maps[frame], compose(invert(world[FRAMES // 2]), world[frame]), atol=0.01)


def test_at_the_end_of_a_clip_what_shows_nothing_stands():
    world = [similarity(frame) for frame in range(FRAMES)]
    points, targets = correspondences(world)
    usable = np.ones(targets.shape[:3], np.uint8)
    usable[5:], usable[:, 5:] = 0, 0
    maps = chain(points, targets, usable, EVERY, UNIT)
    np.testing.assert_allclose(maps[4], compose(invert(world[FRAMES // 2]), world[4]), atol=1e-3)
    np.testing.assert_allclose(maps[[5, 6]], maps[[4, 4]], atol=1e-9)


def test_a_few_stray_points_do_not_lead_the_scene_but_an_object_may_be_small():
    """Fifteen of two thousand points go with something else, and no others are seen."""
    random = np.random.default_rng(0)
    points = random.uniform((0, 0), (WIDTH, HEIGHT), (FRAMES, 2000, 2)).astype(np.float32)
    gap = (np.arange(FRAMES)[None] - np.arange(FRAMES)[:, None])[..., None, None]
    targets = (points[:, None] + gap * np.array([5.0, 1.0])).astype(np.float32)
    few = np.zeros(targets.shape[:3], np.uint8)
    few[:, :, :15] = 255
    every, still = np.ones(points.shape[:2], np.bool_), np.tile(np.eye(2, 3), (FRAMES, 1, 1))
    np.testing.assert_array_equal(chain(points, targets, few, every, UNIT), still)
    small = chain(points, targets, few, every, UNIT, similarity=True, fallback=still)
    np.testing.assert_allclose(small[0], [[1, 0, 15], [0, 1, 3]], atol=0.01)


def test_without_points_a_chain_follows_the_fallback_or_stands_still():
    world = [similarity(frame) for frame in range(FRAMES)]
    points, targets = correspondences(world)
    nothing = np.zeros(targets.shape[:3], np.uint8)
    np.testing.assert_array_equal(chain(points, targets, nothing, EVERY, UNIT), np.tile(np.eye(2, 3), (FRAMES, 1, 1)))
    fallback = chain(points, targets, nothing + np.uint8(1), EVERY, UNIT)
    np.testing.assert_allclose(chain(points, targets, nothing, EVERY, UNIT, fallback=fallback), fallback, atol=1e-9)


def test_compose_and_invert():
    first, second = sheared(2), sheared(5)
    xy = np.array([[3.0, 4.0], [-1.0, 7.0]])
    np.testing.assert_allclose(apply(compose(second, first), xy), apply(second, apply(first, xy)))
    np.testing.assert_allclose(apply(invert(first), apply(first, xy)), xy)
    assert homogeneous(first)[2].tolist() == [0, 0, 1]


@pytest.mark.parametrize(("height", "width"), [(60, 90), (90, 60), (64, 64)])
def test_normalised_maps_agree_with_the_image_plane(height: int, width: int):
    plane = ImagePlane(height, width)
    pixels = np.stack([sheared(frame) for frame in range(FRAMES)])
    maps = torch.from_numpy(to_normalised(pixels, height, width)).double()
    xy = torch.rand(20, 2, generator=torch.Generator().manual_seed(0)).double() * 60
    for frame in range(FRAMES):
        moved = torch.from_numpy(apply(pixels[frame], xy.numpy()))
        normalised = plane.normalise(xy) @ maps[frame, :, :2].T + maps[frame, :, 2]
        # the maps are kept in float32
        torch.testing.assert_close(normalised, plane.normalise(moved), rtol=0, atol=1e-5)

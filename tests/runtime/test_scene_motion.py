from __future__ import annotations

import cv2
import numpy as np
import pytest

from decomo_runtime import RenderError, Tracks
from decomo_runtime.raster import Raster
from decomo_runtime.scene_motion import SPAN, SceneMotion, follow_scene
from tiny_fit import FRAMES, HEIGHT, SCENE_VELOCITY, WIDTH
from true_tracker import TrueTracker

TURN = np.array([[0.98, -0.1, 9.0], [0.1, 0.98, -5.0], [2e-4, 1e-4, 1.0]])
"""A homography of a 96x64 image."""


def moved(xy: np.ndarray) -> np.ndarray:
    if xy.size == 0:
        return xy
    return cv2.perspectiveTransform(xy.reshape(1, -1, 2).astype(np.float64), TURN).reshape(xy.shape)


def motion_of(xy: np.ndarray, queries: np.ndarray, occluded: np.ndarray) -> SceneMotion:
    """Of a clip of frames of 96x64 in which the `queries` of frame 0 are at `xy` [N, T, 2]."""

    def track(points: np.ndarray, frames: np.ndarray) -> Tracks:
        assert points is queries or (points == queries).all()
        return Tracks(xy[:, frames], occluded[:, frames], occluded[:, frames].astype(np.float32), points, frames)

    return SceneMotion(track, queries, (xy.shape[1], 64, 96))


def two_frames(points: int = 300, wrong: int = 0, hidden: bool = False) -> SceneMotion:
    """Points of a 96x64 image moved by `TURN`; the last `wrong` of them elsewhere."""
    random = np.random.default_rng(0)
    here = random.uniform(0, (96, 64), (points, 2))
    there = moved(here)
    there[points - wrong :] += random.uniform(-30, 30, (wrong, 2))
    xy = np.stack([here, there], axis=1).astype(np.float32)
    occluded = np.zeros((points, 2), bool)
    occluded[:, 1] = hidden
    queries = np.concatenate([np.zeros((points, 1)), here], axis=1).astype(np.float32)
    return motion_of(xy, queries, occluded)


@pytest.mark.parametrize("wrong", [0, 60])
def test_a_plane_is_carried_exactly_and_wrong_tracks_do_not_matter(wrong: int):
    motion = two_frames(wrong=wrong)
    places = np.array([[[10.0, 10.0], [90.0, 5.0]], [[40.0, 60.0], [-20.0, 70.0]]])  # inside and outside
    np.testing.assert_allclose(motion.carry(places, 0, 1), moved(places), atol=0.05)  # smoothing of float32
    np.testing.assert_allclose(motion.carry(moved(places), 1, 0), places, atol=0.1)
    field = motion.field(0, 1)
    assert field.shape == (64, 96, 2)
    np.testing.assert_allclose(field[20, 70], moved(np.array([70.0, 20.0])), atol=0.05)


def test_parallax_is_interpolated_where_points_are_missing():
    """A bump on the plane, and a hole in the points across its flank, as an object makes one."""
    random = np.random.default_rng(0)
    here = random.uniform(0, (96, 64), (1500, 2))
    here = here[np.abs(here - [30, 30]).max(axis=1) > 6]

    def bumped(xy: np.ndarray) -> np.ndarray:
        height = 3 * np.exp(-((xy - [48, 32]) ** 2).sum(axis=-1, keepdims=True) / (2 * 15**2))
        return moved(xy) + height * [1, 0.5]

    xy = np.stack([here, bumped(here)], axis=1).astype(np.float32)
    queries = np.concatenate([np.zeros((len(here), 1)), here], axis=1).astype(np.float32)
    seen = np.zeros((len(here), 2), bool)
    motion = motion_of(xy, queries, seen)
    places = np.array([[48.0, 32.0], [30.0, 30.0], [70.0, 40.0], [10.0, 60.0]])
    assert np.abs(moved(places) - bumped(places)).max() > 2
    np.testing.assert_allclose(motion.carry(places, 0, 1), bumped(places), atol=0.6)  # smoothed over two cells of 3


def test_a_frame_and_itself():
    motion = two_frames(points=0)
    assert motion.knows(1, 1)
    np.testing.assert_array_equal(motion.carry([(3.0, 4.0)], 1, 1), [(3, 4)])


@pytest.mark.parametrize("motion", [two_frames(points=5), two_frames(hidden=True), two_frames(points=0)])
def test_too_few_common_points_tell_nothing(motion: SceneMotion):
    assert not motion.knows(0, 1)
    assert np.isnan(motion.carry([(3.0, 4.0)], 0, 1)).all()


def test_places_that_are_no_numbers_or_far_away():
    places = np.array([[np.nan, 1.0], [1e9, 3.0], [5.0, 5.0]])
    carried = two_frames().carry(places, 0, 1)
    assert np.isnan(carried[0]).all()
    np.testing.assert_allclose(carried[2], moved(places[2]), atol=0.05)
    assert two_frames().carry(np.empty((0, 2)), 0, 1).shape == (0, 2)


def test_many_places_at_once_are_as_one_by_one():
    """More than cv2.remap takes in one piece."""
    places = np.random.default_rng(1).uniform(0, 64, (70_000, 2))
    motion = two_frames()
    carried = motion.carry(places, 0, 1)
    for row in (0, 29_999, 30_000, 69_999):
        np.testing.assert_allclose(carried[row], motion.carry(places[row], 0, 1), atol=1e-6)


def test_the_scene_behind_the_square_moves_with_the_scene():
    motion = follow_scene(TrueTracker())
    field = motion.field(3, 5)
    expected = np.stack(np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT)), axis=-1) + 2 * SCENE_VELOCITY
    np.testing.assert_allclose(field, expected, atol=0.05)
    assert all(motion.knows(0, frame) for frame in range(FRAMES))


@pytest.mark.parametrize(("share", "static", "others"), [(0.1, 0.92, 0.88), (0.5, 0.51, 0.49), (0.02, 0.985, 0.95)])
def test_the_scene_is_what_no_object_owns(share: float, static: float, others: float):
    """By the model's own rule: what it follows with the dynamic volume tells nothing of the camera."""
    motion = follow_scene(TrueTracker(static, object_share=share))
    np.testing.assert_allclose(motion.carry([(0.0, 0.0)], 3, 5), [2 * SCENE_VELOCITY], atol=0.05)
    with pytest.raises(RenderError, match=r"sliding\.onnx holds nothing in sliding to be static"):
        follow_scene(TrueTracker(others, object_share=share))


def test_parallax_is_read_where_it_is():
    """The scene parts along x = 47.5, and along y = 31.5: each half goes its own way by 0.8 pixels."""
    y, x = np.mgrid[0:64:1.5, 0:96:1.5]
    here = np.stack([x, y], axis=-1).reshape(-1, 2)
    for axis, middle in ((0, 47.5), (1, 31.5)):
        there = here.copy()
        there[:, axis] += 0.8 * np.sign(here[:, axis] - middle)
        xy = np.stack([here, there], axis=1).astype(np.float32)
        seen = np.zeros((len(here), 2), bool)
        queries = np.concatenate([np.zeros((len(here), 1)), here], axis=1).astype(np.float32)
        motion = motion_of(xy, queries, seen)
        along = np.full((200, 2), (40.0, 26.0))
        along[:, axis] = middle + np.linspace(-6, 6, 200)
        shift = (motion.carry(along, 0, 1) - along)[:, axis]
        assert shift[0] == pytest.approx(-0.8, abs=0.15)
        assert shift[-1] == pytest.approx(0.8, abs=0.15)
        assert along[np.abs(shift).argmin(), axis] == pytest.approx(middle, abs=0.7)


def test_a_field_on_a_part_of_another_raster():
    """Interpolated between every few of its pixels, it is where the pixels are carried to one by one."""
    random = np.random.default_rng(0)
    here = random.uniform(0, (854, 480), (2000, 2))
    matrix = np.array([[0.98, -0.1, 40.0], [0.1, 0.98, -25.0], [1e-4, 5e-5, 1.0]])
    there = cv2.perspectiveTransform(here[None], matrix)[0] + 6 * np.sin(here / 150)
    queries = np.concatenate([np.zeros((len(here), 1)), here], axis=1).astype(np.float32)

    def track(points: np.ndarray, frames: np.ndarray) -> Tracks:
        xy = np.stack([here, there], axis=1)[:, frames].astype(np.float32)
        return Tracks(xy, np.zeros(xy.shape[:2], bool), np.zeros(xy.shape[:2], np.float32), points, frames)

    motion = SceneMotion(track, queries, (2, 480, 854))
    for raster in (Raster((480, 854), slice(7, 301), slice(433, 854)), Raster((144, 256), slice(0, 61), slice(5, 6))):
        scale = np.array([854 / raster.size[1], 480 / raster.size[0]])
        x, y = np.arange(raster.size[1])[raster.columns], np.arange(raster.size[0])[raster.rows]
        grid = (np.stack(np.meshgrid(x, y), axis=-1) + 0.5) * scale - 0.5
        expected = (motion.carry(grid, 0, 1) + 0.5) / scale - 0.5
        field = motion.field(0, 1, raster)
        assert field.shape == (*raster.shape, 2)
        np.testing.assert_allclose(field, expected, atol=0.05)


def test_what_is_followed_for_two_frames_does_not_grow_with_the_clip():
    asked: list[tuple[float, float, int, np.ndarray]] = []

    def track(points: np.ndarray, frames: np.ndarray) -> Tracks:
        asked.append((points[0, 0], points[-1, 0], len(points) * len(frames), frames))
        still = np.repeat(points[:, None, 1:], len(frames), axis=1)
        seen = np.zeros(still.shape[:2], bool)
        return Tracks(still, seen, seen.astype(np.float32), points, frames)

    grid = np.stack(np.meshgrid(np.arange(0, 96, 8), np.arange(0, 64, 8)), axis=-1).reshape(-1, 2)
    counts = []
    for length in (400, 4000):
        asked.clear()
        key_frames = np.repeat(np.arange(0, length, 12), len(grid))
        points = np.column_stack([key_frames, np.tile(grid, (len(key_frames) // len(grid), 1))]).astype(np.float32)
        motion = SceneMotion(track, points, (length, 64, 96))
        for frame in range(200, 216):
            np.testing.assert_allclose(motion.carry([(9.0, 7.0)], frame, 203), [(9, 7)], atol=1e-3)
        for first, last, _, frames in asked:
            assert first == last  # one key frame at a time
            assert 200 - SPAN <= first <= 216 + SPAN
            assert frames[0] > 180
            assert frames[-1] < 240
        counts.append(sum(count for _, _, count, _ in asked))
    assert counts[0] == counts[1] > 0

"""The camera between two frames: models and distances, each against a case worked by hand."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from decomotion.data.masks import cameras


def test_transfer_distance():
    shift = np.array([[1.0, 0, 3], [0, 1, 4], [0, 0, 1]])
    xy = np.array([[0, 0], [10, 20]], np.float32)
    np.testing.assert_allclose(cameras.transfer_distance(shift, xy, xy), [5, 5])


def test_sampson_distance_sees_across_epipolar_lines_only():
    """A camera that moves sideways: y stays; an error of d in y is shared by both images, d / sqrt(2)."""
    sideways = np.array([[0.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    source = np.array([[5, 7], [5, 7]], np.float32)
    target = np.array([[90, 7], [5, 9]], np.float32)
    np.testing.assert_allclose(cameras.sampson_distance(sideways, source, target), [0, 2 / 2**0.5], atol=1e-6)


def test_fundamental_matrix_of_two_depths():
    random = np.random.default_rng(0)
    source = random.uniform(0, 255, (400, 2)).astype(np.float32)
    depth = random.uniform(1, 3, (400, 1)).astype(np.float32)
    target = (source + np.array([10.0, 4.0]) / depth).astype(np.float32)
    target[:40] = random.uniform(0, 255, (40, 2))
    matrix = cameras.fit_fundamental(source, target)
    assert matrix is not None
    assert np.median(cameras.sampson_distance(matrix, source[40:], target[40:])) < 0.05


def test_no_fundamental_matrix_of_nothing():
    assert cameras.fit_fundamental(np.zeros((3, 2), np.float32), np.zeros((3, 2), np.float32)) is None


def test_the_camera_s_way_back():
    random = np.random.default_rng(2)
    homography = np.array([[1.1, 0.05, 4.0], [-0.03, 0.95, -2.0], [1e-4, 0.0, 1.0]])
    camera = cameras.Camera(homography, random.normal(size=(3, 3)))
    back = camera.inverse()
    assert back.fundamental is not None
    source, target = random.uniform(0, 200, (2, 30, 2)).astype(np.float32)
    there = cv2.perspectiveTransform(source[None], homography)[0]
    np.testing.assert_allclose(cameras.transfer_distance(back.homography, there, source), 0, atol=1e-3)
    np.testing.assert_allclose(
        cameras.sampson_distance(back.fundamental, target, source),
        cameras.sampson_distance(camera.fundamental, source, target),  # type: ignore[arg-type]
        rtol=1e-4,
    )


def test_points_are_drawn_by_their_weight():
    """One point in four weighs three times as much as the others: at first half of those drawn are such."""
    weight = np.where(np.arange(10**5) % 4 == 0, 3.0, 1.0)
    drawn = cameras.draw(weight, np.random.default_rng(0))
    assert (drawn % 4 == 0).mean() == pytest.approx(0.5, abs=0.05)


def test_drawn_points_are_few_distinct_and_allowed():
    weight = np.r_[np.zeros(100), np.ones(5000)]
    drawn = cameras.draw(weight, np.random.default_rng(0))
    assert len(drawn) == len(set(drawn)) == cameras.SAMPLE
    assert drawn.min() >= 100


def test_frames_are_compared_with_those_up_to_eight_away():
    assert cameras.neighbours(0, 20) == [1, 2, 3, 4, 5, 6, 7, 8]
    assert cameras.neighbours(10, 30) == [2, 3, 4, 5, 6, 7, 8, 9, 11, 12, 13, 14, 15, 16, 17, 18]
    assert cameras.neighbours(18, 20) == [10, 11, 12, 13, 14, 15, 16, 17, 19]
    assert cameras.neighbours(2, 4) == [0, 1, 3]


def test_the_border_is_a_tenth_of_the_longer_side():
    x, y = [9.9, 10.1, 88.9, 89.1, 50, 50, 50, 50], [25, 25, 25, 25, 9.9, 10.1, 38.9, 39.1]
    found = cameras.near_border(np.array([x, y], np.float32).T, height=50, width=100)
    assert found.tolist() == [True, False, False, True, True, False, False, True]
    upright = cameras.near_border(np.array([y, x], np.float32).T, height=100, width=50)
    assert upright.tolist() == found.tolist()


def test_sampson_distance_of_any_matrix():
    """Hartley and Zisserman's 11.9, one correspondence at a time."""
    random = np.random.default_rng(0)
    matrix = random.normal(size=(3, 3))
    source, target = (random.uniform(0, 200, (5, 2)).astype(np.float32) for _ in range(2))
    found = cameras.sampson_distance(matrix, source, target)
    for (x, y), (u, v), distance in zip(source, target, found, strict=True):
        a, b, c = (row[0] * x + row[1] * y + row[2] for row in matrix)
        d, e = (matrix[0][k] * u + matrix[1][k] * v + matrix[2][k] for k in (0, 1))
        expected = abs(u * a + v * b + c) / (a**2 + b**2 + d**2 + e**2) ** 0.5
        assert distance == pytest.approx(expected, rel=1e-4)

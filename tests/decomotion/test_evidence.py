"""Evidence of motion: residuals of both camera models, and the look at colours, each against a case worked by hand."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from decomotion.data.masks import evidence


def test_units_cover_the_same_area():
    np.testing.assert_allclose(
        evidence.to_units(np.array([[-0.5, 511.5], [255.5, 0.0]], np.float32), 512, 256),
        [[-0.5, 255.5], [127.5, -0.25]],
    )
    assert evidence.in_units(np.zeros((64, 128, 3), np.uint8)).shape == (128, 256, 3)


def test_transfer_distance():
    shift = np.array([[1.0, 0, 3], [0, 1, 4], [0, 0, 1]])
    xy = np.array([[0, 0], [10, 20]], np.float32)
    np.testing.assert_allclose(evidence.transfer_distance(shift, xy, xy), [5, 5])


def test_sampson_distance_sees_across_epipolar_lines_only():
    """A camera that moves sideways: y stays; an error of d in y is shared by both images, d / sqrt(2)."""
    sideways = np.array([[0.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    source = np.array([[5, 7], [5, 7]], np.float32)
    target = np.array([[90, 7], [5, 9]], np.float32)
    np.testing.assert_allclose(evidence.sampson_distance(sideways, source, target), [0, 2 / 2**0.5], atol=1e-6)


def test_fundamental_matrix_of_two_depths():
    random = np.random.default_rng(0)
    source = random.uniform(0, 255, (400, 2)).astype(np.float32)
    depth = random.uniform(1, 3, (400, 1)).astype(np.float32)
    target = (source + np.array([10.0, 4.0]) / depth).astype(np.float32)
    target[:40] = random.uniform(0, 255, (40, 2))
    matrix = evidence.fit_fundamental(source, target)
    assert matrix is not None
    assert np.median(evidence.sampson_distance(matrix, source[40:], target[40:])) < 0.05


def test_no_fundamental_matrix_of_nothing():
    assert evidence.fit_fundamental(np.zeros((3, 2), np.float32), np.zeros((3, 2), np.float32)) is None


@pytest.mark.parametrize(("shares", "trust"), [([0.0, 0.01], 0.25), ([0.1, 0.1, 0.9], 0.5), ([0.4], 0.75)])
def test_epipolar_geometry_is_believed_where_the_border_needs_it(shares: list[float], trust: float):
    assert evidence.epipolar_trust(shares) == pytest.approx(trust)


def test_combined_is_a_geometric_mean():
    planar, epipolar = np.array([8.0, 8.0], np.float32), np.array([0.5, 0.0], np.float32)
    result = evidence.combined(planar, epipolar, 0.5)
    # 4 x 0.5 and 8: 4; the noise is 0.05
    np.testing.assert_allclose(result, [4.06, (8.05 * 0.05) ** 0.5], rtol=0.01)
    assert np.isnan(evidence.combined(np.array([np.nan], np.float32), np.array([1.0], np.float32), 0.5)).all()


def test_the_camera_s_way_back():
    random = np.random.default_rng(2)
    homography = np.array([[1.1, 0.05, 4.0], [-0.03, 0.95, -2.0], [1e-4, 0.0, 1.0]])
    camera = evidence._Camera(homography, random.normal(size=(3, 3)))
    back = evidence.inverse(camera)
    assert back is not None
    assert back.fundamental is not None
    source, target = random.uniform(0, 200, (2, 30, 2)).astype(np.float32)
    there = cv2.perspectiveTransform(source[None], homography)[0]
    np.testing.assert_allclose(evidence.transfer_distance(back.homography, there, source), 0, atol=1e-3)
    np.testing.assert_allclose(
        evidence.sampson_distance(back.fundamental, target, source),
        evidence.sampson_distance(camera.fundamental, source, target),  # type: ignore[arg-type]
        rtol=1e-4,
    )
    assert evidence.inverse(None) is None


def test_points_are_drawn_by_their_weight():
    """One point in four weighs three times as much as the others: at first half of those drawn are such."""
    weight = np.where(np.arange(10**5) % 4 == 0, 3.0, 1.0)
    drawn = evidence.draw(weight, np.random.default_rng(0))
    assert (drawn % 4 == 0).mean() == pytest.approx(0.5, abs=0.05)


def test_drawn_points_are_few_distinct_and_allowed():
    weight = np.r_[np.zeros(100), np.ones(5000)]
    drawn = evidence.draw(weight, np.random.default_rng(0))
    assert len(drawn) == len(set(drawn)) == evidence.SAMPLE
    assert drawn.min() >= 100


class TestPhotometricChange:
    def test_undoing_the_camera_leaves_only_what_moves(self):
        random = np.random.default_rng(0)
        wide = random.integers(0, 255, (64, 80, 3)).astype(np.uint8)
        first, second = wide[:, 5:69].copy(), wide[:, :64].copy()
        second[20:40, 30:50] = 0
        shift = np.array([[1.0, 0, 5], [0, 1, 0], [0, 0, 1]])
        xy = np.array([[10, 10], [15, 50], [35, 30], [62, 10]], np.float32)
        change = evidence.photometric_change(first, second, xy, shift)
        assert change[:2].tolist() == [0, 0]
        assert change[2] > 20
        assert np.isnan(change[3])


def test_quantiles_leave_out_what_is_not_known():
    nan = np.nan
    values = [np.array(row, np.float32) for row in ([3, nan, nan], [1, 5, nan], [2, nan, nan])]
    np.testing.assert_array_equal(evidence.quantile(values, 0.5), [2, 5, nan])
    np.testing.assert_array_equal(evidence.quantile(values, 0.7), [3, 5, nan])


def test_frames_are_compared_with_those_up_to_eight_away():
    assert evidence.neighbours(0, 20) == [1, 2, 3, 4, 5, 6, 7, 8]
    assert evidence.neighbours(10, 30) == [2, 3, 4, 5, 6, 7, 8, 9, 11, 12, 13, 14, 15, 16, 17, 18]
    assert evidence.neighbours(18, 20) == [10, 11, 12, 13, 14, 15, 16, 17, 19]
    assert evidence.neighbours(2, 4) == [0, 1, 3]


def test_the_border_is_a_tenth_of_the_longer_side():
    x, y = [9.9, 10.1, 88.9, 89.1, 50, 50, 50, 50], [25, 25, 25, 25, 9.9, 10.1, 38.9, 39.1]
    found = evidence.near_border(np.array([x, y], np.float32).T, height=50, width=100)
    assert found.tolist() == [True, False, False, True, True, False, False, True]
    upright = evidence.near_border(np.array([y, x], np.float32).T, height=100, width=50)
    assert upright.tolist() == found.tolist()


def test_sampson_distance_of_any_matrix():
    """Hartley and Zisserman's 11.9, one correspondence at a time."""
    random = np.random.default_rng(0)
    matrix = random.normal(size=(3, 3))
    source, target = (random.uniform(0, 200, (5, 2)).astype(np.float32) for _ in range(2))
    found = evidence.sampson_distance(matrix, source, target)
    for (x, y), (u, v), distance in zip(source, target, found, strict=True):
        a, b, c = (row[0] * x + row[1] * y + row[2] for row in matrix)
        d, e = (matrix[0][k] * u + matrix[1][k] * v + matrix[2][k] for k in (0, 1))
        expected = abs(u * a + v * b + c) / (a**2 + b**2 + d**2 + e**2) ** 0.5
        assert distance == pytest.approx(expected, rel=1e-4)


def test_the_more_of_the_border_only_epipolar_geometry_explains_the_more_it_is_believed():
    """Of five visible border points, two are 1.6 units off the homography and 0.4 off the epipolar line."""
    planar = np.array([1.6, 1.6, 1.6, 1.4, 0.2, np.nan, 1.6], np.float32)
    epipolar = np.array([0.4, 0.4, 0.6, 0.4, 0.1, np.nan, 0.4], np.float32)
    border = np.array([True, True, True, True, True, True, False])
    pair = evidence._Pair(np.eye(3), planar, epipolar)
    assert pair.parallax_share(border) == pytest.approx(2 / 5)
    assert pair.parallax_share(np.zeros(7, np.bool_)) == 0
    assert evidence.epipolar_trust([0.05, 0.075, 0.15]) == pytest.approx(0.375)  # a quarter of the way


def changed_by(levels: int, everywhere: int = 0, size: tuple[int, int] = (30, 50)) -> tuple[np.ndarray, np.ndarray]:
    """Two grey images that differ by so much in one pixel, and by so much in all."""
    image = np.full((*size, 3), 100, np.uint8)
    other = image + np.uint8(everywhere)
    other[12, 20] += np.uint8(levels)
    return image, other


@pytest.mark.parametrize(("everywhere", "expected"), [(0, [3, 3, 0, 0]), (4, [7 / 4, 7 / 4, 1, 1])])
def test_change_is_of_five_units_around_and_relative_to_the_median(everywhere: int, expected: list[float]):
    """75 levels in one of 25 pixels are 3; where the median is less than a level it counts as one."""
    xy = np.array([[20, 12], [22, 10], [23, 12], [20, 15], [35, 5], [40, 25], [5, 5], [10, 20]], np.float32)
    change = evidence.photometric_change(*changed_by(75, everywhere), xy, np.eye(3))
    np.testing.assert_allclose(change[:4], expected, atol=1e-5)


def test_change_is_not_known_outside():
    images, shift = changed_by(0), np.array([[1.0, 0, 4], [0, 1, -3], [0, 0, 1]])
    xy = np.array([[45, 29], [45.1, 29], [-4, 10], [-4.1, 10], [5, 3], [5, 2.9], [5, 29], [5, 32.1]], np.float32)
    known = ~np.isnan(evidence.photometric_change(*images, xy, shift))
    assert known.tolist() == [True, False, True, False, True, False, True, False]
    assert np.isnan(evidence.photometric_change(*images, xy[[1, 3]], shift)).all()


def lattice(rows: int, columns: int, height: int, width: int) -> np.ndarray:
    y, x = np.mgrid[:rows, :columns].astype(np.float32)
    return np.stack([(x + 0.5) * width / columns - 0.5, (y + 0.5) * height / rows - 0.5], axis=-1).reshape(-1, 2)


def test_the_residual_of_what_moves_before_a_still_camera(monkeypatch: pytest.MonkeyPatch):
    """A point that goes 3 units a frame is off by 3 gap / sqrt(gap); the lower median over the pairs counts."""
    monkeypatch.setattr(evidence, "fit_fundamental", lambda *_: None)  # the homography decides alone
    height, width, frames = 144, 256, 5
    points = np.tile(lattice(9, 16, height, width), (frames, 1, 1))
    gap = np.arange(frames)[None] - np.arange(frames)[:, None]
    targets = np.tile(points[:, None], (1, frames, 1, 1))
    targets[:, :, 70] += gap[..., None] * np.array([3, 0], np.float32)
    images = np.full((frames, height, width, 3), 90, np.uint8)
    confidence = np.full(targets.shape[:3], 255, np.uint8)
    confidence[3, :, 3] = 0
    confidence[1, :, 20:] = 0  # of a frame with fewer than 64 points nothing is known
    random = np.random.default_rng(0)
    found = evidence.motion_evidence(images, points, targets, confidence, (height, width), random)
    assert found.residual[2, 70] == pytest.approx(3.05, rel=1e-3)  # over gaps 1, 1, 2, 2
    assert found.residual[0, 70] == pytest.approx(3 * 2**0.5 + 0.05, rel=1e-3)  # over gaps 1, 2, 3, 4
    np.testing.assert_allclose(np.delete(found.residual[2], 70), 0.05, atol=1e-3)
    assert np.isnan(found.residual[3, 3])
    assert np.isnan(found.residual[1]).all()
    assert np.isnan(found.change[1]).all()
    assert not found.change[2].any()

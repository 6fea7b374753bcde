"""Evidence of motion: residuals of both camera models, and the look at colours, each against a case worked by hand."""

from __future__ import annotations

import numpy as np
import pytest

from decomotion.data.masks import evidence


def test_units_cover_the_same_area():
    np.testing.assert_allclose(
        evidence.to_units(np.array([[-0.5, 511.5], [255.5, 0.0]], np.float32), 512, 256),
        [[-0.5, 255.5], [127.5, -0.25]],
    )
    assert evidence.in_units(np.zeros((2, 64, 128, 3), np.uint8)).shape == (2, 128, 256, 3)


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

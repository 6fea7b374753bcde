"""Evidence of motion: residuals to the camera, and the look at colours, each against a case worked by hand."""

from __future__ import annotations

import numpy as np
import pytest

from decomotion.data.masks import cameras, evidence
from decomotion.data.masks.cameras import Cameras
from decomotion.data.masks.links import Links
from decomotion.units import to_units


def test_units_cover_the_same_area():
    np.testing.assert_allclose(
        to_units(np.array([[-0.5, 511.5], [255.5, 0.0]], np.float32), 512, 256),
        [[-0.5, 255.5], [127.5, -0.25]],
    )
    assert evidence.in_units(np.zeros((64, 128, 3), np.uint8)).shape == (128, 256, 3)


@pytest.mark.parametrize(("shares", "trust"), [([0.0, 0.01], 0.25), ([0.1, 0.1, 0.9], 0.5), ([0.4], 0.75)])
def test_epipolar_geometry_is_believed_where_the_border_needs_it(shares: list[float], trust: float):
    assert evidence.epipolar_trust(shares) == pytest.approx(trust)


def test_combined_is_a_geometric_mean():
    planar, epipolar = np.array([8.0, 8.0], np.float32), np.array([0.5, 0.0], np.float32)
    result = evidence.combined(planar, epipolar, 0.5)
    # 4 x 0.5 and 8: 4; the noise is 0.05
    np.testing.assert_allclose(result, [4.06, (8.05 * 0.05) ** 0.5], rtol=0.01)
    assert np.isnan(evidence.combined(np.array([np.nan], np.float32), np.array([1.0], np.float32), 0.5)).all()


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
    monkeypatch.setattr(cameras, "fit_fundamental", lambda *_: None)  # the homography decides alone
    height, width, frames = 144, 256, 5
    points = np.tile(lattice(9, 16, height, width), (frames, 1, 1))
    gap = np.arange(frames)[None] - np.arange(frames)[:, None]
    targets = np.tile(points[:, None], (1, frames, 1, 1))
    targets[:, :, 70] += gap[..., None] * np.array([3, 0], np.float32)
    images = np.full((frames, height, width, 3), 90, np.uint8)
    confidence = np.full(targets.shape[:3], 255, np.uint8)
    confidence[3, :, 3] = 0
    confidence[1, :, 20:] = 0  # of a frame with fewer than 64 points nothing is known
    links = Links(points, targets, confidence, (9, 16), (height, width))
    motion = Cameras(links, height, width, np.random.default_rng(0))
    found = evidence.motion_evidence(images, links, motion, range(frames))
    np.testing.assert_array_equal(evidence.motion_evidence(images, links, motion, [2]).residual[2], found.residual[2])
    assert np.isnan(evidence.motion_evidence(images, links, motion, [2]).residual[[0, 4]]).all()
    assert found.residual[2, 70] == pytest.approx(3.05, rel=1e-3)  # over gaps 1, 1, 2, 2
    assert found.residual[0, 70] == pytest.approx(3 * 2**0.5 + 0.05, rel=1e-3)  # over gaps 1, 2, 3, 4
    np.testing.assert_allclose(np.delete(found.residual[2], 70), 0.05, atol=1e-3)
    assert np.isnan(found.residual[3, 3])
    assert np.isnan(found.residual[1]).all()
    assert np.isnan(found.change[1]).all()
    assert not found.change[2].any()

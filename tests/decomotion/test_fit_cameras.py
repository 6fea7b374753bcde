"""Cameras by the places of points: least squares, coordinates chosen anew, and what is done with few points."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from decomotion.data.structure.cameras import _centred, _fitted, _shifts, fit_cameras

Floats = npt.NDArray[np.floating]


def made(points: int, frames: int = 3) -> tuple[Floats, Floats, Floats]:
    """Points, cameras with perspective, and where they are seen."""
    random = np.random.default_rng(5)
    x = random.normal(scale=0.5, size=(points, 3))
    cameras = np.tile(np.eye(3, 4), (frames, 1, 1)) + random.normal(scale=0.1, size=(frames, 3, 4))
    cameras[:, 2] = (*(0.1, -0.2, 0.15), 1)
    return x, cameras, projected(x, cameras)


def projected(x: Floats, cameras: Floats) -> Floats:
    seen = np.einsum("tij,nj->nti", cameras, np.concatenate([x, np.ones((len(x), 1))], axis=1))
    return seen[..., :2] / seen[..., 2:]


def affine(frames: int) -> Floats:
    former = np.tile(np.eye(3, 4), (frames, 1, 1))
    former[:, 2] = (0, 0, 0, 1)
    return former


def test_exact_links_tell_the_camera() -> None:
    """Whatever they weigh. Where fewer than twenty are seen it stays as it was, and what it was is not touched."""
    x, cameras, seen = made(40)
    weight = np.random.default_rng(0).uniform(0.5, 1, (40, 3))
    weight[19:, 2] = 0
    former = affine(3)
    found = _fitted(seen, weight, x, former, 1e-6)
    np.testing.assert_allclose(found[:2], cameras[:2], atol=1e-3)
    np.testing.assert_array_equal(found[2], former[2])
    np.testing.assert_array_equal(former, affine(3))
    weight[19, 2] = 1
    assert not (_fitted(seen, weight, x, former, 1e-6)[2] == former[2]).all()


def test_at_first_cameras_have_no_perspective() -> None:
    x, _, seen = made(40)
    found = _fitted(seen, np.ones((40, 3)), x, affine(3), 1e6)
    np.testing.assert_allclose(found[:, 2], [[0, 0, 0, 1]] * 3, atol=1e-5)
    design = np.concatenate([x, np.ones((40, 1))], axis=1)
    for frame in range(3):
        expected = np.linalg.lstsq(design, seen[:, frame], rcond=None)[0].T
        np.testing.assert_allclose(found[frame, :2], expected, atol=1e-4)


def test_other_coordinates_show_the_same() -> None:
    x, cameras, seen = made(60)
    moved, others = _centred(3 * x + (1, 2, 3), cameras @ np.linalg.inv(_enlarged(3, (1, 2, 3))))
    np.testing.assert_allclose(projected(moved, others), seen, atol=1e-9)
    np.testing.assert_allclose(moved.mean(axis=0), 0, atol=1e-9)
    np.testing.assert_allclose(np.cov(moved.T), 0.25 * np.eye(3), atol=1e-6)
    np.testing.assert_allclose(others[:, 2, 3], 1)


def _enlarged(scale: float, shift: tuple[float, float, float]) -> Floats:
    matrix = np.diag([scale, scale, scale, 1.0])
    matrix[:3, 3] = shift
    return matrix


def test_neighbouring_frames_tell_the_first_way() -> None:
    """The median of those that both show, added up; where there is none it stands."""
    seen = np.zeros((5, 4, 2))
    seen[:, 1] = [[0.1, 0.2], [0.1, 0.2], [0.2, 0.2], [9.0, -9.0], [0.1, 0.3]]
    seen[:, 2] = seen[:, 1] + (0.5, 0)
    seen[:, 3] = 7
    known = np.ones((5, 4), bool)
    known[:, 3] = False
    known[4, 2] = False
    seen[4, 2] = 99
    np.testing.assert_allclose(_shifts(seen, known), [[0, 0], [0.1, 0.2], [0.6, 0.2], [0.6, 0.2]])


@pytest.mark.parametrize(
    ("points", "links", "fitted"), [(19, 12, False), (20, 12, True), (40, 6, False), (40, 7, True)]
)
def test_cameras_are_fitted_to_twenty_points_with_seven_links(points: int, links: int, fitted: bool) -> None:
    """Fewer only tell how the picture shifts."""
    _, cameras, seen = made(points, frames=12)
    counts = np.ones((points, 12))
    counts[:, links:] = 0
    gap = np.tile(np.arange(12), (points, 1))
    found = fit_cameras(seen, counts, gap, np.random.default_rng(0))
    plain = np.abs(found[:, :2, :3] - np.eye(2, 3)).max() < 1e-9 and np.abs(found[:, 2] - (0, 0, 0, 1)).max() < 1e-9
    assert plain == (not fitted)
    assert cameras.shape == found.shape


def test_the_generator_draws_the_first_depths() -> None:
    _, _, seen = made(40, frames=8)
    gap = np.tile(np.arange(8), (40, 1))
    one, same, other = (fit_cameras(seen, np.ones((40, 8)), gap, np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert np.array_equal(one, same)
    assert not np.array_equal(one, other)


def test_points_that_come_into_sight_tell_no_way() -> None:
    """From a frame in which they are not known; and those that go out of sight tell none either."""
    seen = np.zeros((3, 3, 2))
    seen[:, 1], seen[:, 2] = (0.1, 0.2), (0.3, 0.2)
    seen[1:, 1] = 7
    known = np.ones((3, 3), bool)
    known[1:, 1] = False
    np.testing.assert_allclose(_shifts(seen, known), [[0, 0], [0.1, 0.2], [0.3, 0.2]])

"""What least squares know of links: distances in the picture, points by plain least squares, weights by hand."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from decomotion.data.structure.equations import Equations, weights

Floats = npt.NDArray[np.floating]


def made(points: int = 5, frames: int = 4) -> tuple[Floats, Floats, Floats]:
    """Points X [point, 3], cameras with perspective, and where they are seen, which is a little off."""
    random = np.random.default_rng(3)
    x = random.normal(scale=0.5, size=(points, 3))
    cameras = np.tile(np.eye(3, 4), (frames, 1, 1))
    cameras[:, 2] = (0, 0, 0, 1)
    cameras += random.normal(scale=0.15, size=cameras.shape)
    return x, cameras, projected(x, cameras) + random.normal(scale=0.1, size=(points, frames, 2))


def projected(x: Floats, cameras: Floats) -> Floats:
    """[point, frame, 2], one at a time."""
    found = np.empty((len(x), len(cameras), 2))
    for point, frame in np.ndindex(found.shape[:2]):
        u, v, depth = cameras[frame] @ (*x[point], 1.0)
        found[point, frame] = u / depth, v / depth
    return found


def test_what_a_link_misses_is_a_distance_in_the_picture() -> None:
    x, cameras, seen = made()
    missed, depth = Equations(seen, cameras).missed(x)
    np.testing.assert_allclose(missed, np.linalg.norm(projected(x, cameras) - seen, axis=-1), rtol=1e-9)
    np.testing.assert_allclose(depth, x @ cameras[:, 2, :3].T + cameras[:, 2, 3], rtol=1e-12)


def test_depths_are_no_less_than_a_fifth_of_the_origin_s() -> None:
    """A camera that sees Z = 1 at depth 0.1, and one behind it: both count as 0.2."""
    camera = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, -0.9, 1]])
    x = np.array([[0.03, 0.04, 1.0], [0.03, 0.04, 3.0]])
    missed, depth = Equations(np.zeros((2, 1, 2)), camera[None]).missed(x)
    np.testing.assert_allclose(depth, 0.2)
    np.testing.assert_allclose(missed, 0.05 / 0.2)


def test_points_are_those_of_plain_least_squares() -> None:
    """Which has a row for each equation, times the root of its weight; and 1e-5 of a link holds it at the origin."""
    _, cameras, seen = made()
    weight = np.random.default_rng(1).random(seen.shape[:2])
    found, normal = Equations(seen, cameras).solved(weight)
    for point in range(len(seen)):
        rows = [
            np.sqrt(weight[point, frame]) * (cameras[frame, axis] - seen[point, frame, axis] * cameras[frame, 2])
            for frame in range(len(cameras))
            for axis in range(2)
        ]
        design = np.concatenate([np.array(rows), np.sqrt(1e-5) * np.eye(3, 4)])
        expected = np.linalg.lstsq(design[:, :3], -design[:, 3], rcond=None)[0]
        np.testing.assert_allclose(found[point], expected, rtol=1e-7)
        np.testing.assert_allclose(normal[point], design[:, :3].T @ design[:, :3], rtol=1e-9)


def test_a_point_without_links_is_at_the_origin_and_none_is_farther_than_6() -> None:
    """One camera moves by 0.01 along x: what is seen 0.1 from where it was would be at Z = 10."""
    cameras = np.tile(np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]]), (2, 1, 1))
    cameras[1, 0, 2] = 0.01
    seen = np.array([[[0.5, -0.2], [0.6, -0.2]]] * 2)
    found, _ = Equations(seen, cameras).solved(np.array([[0.0, 0.0], [1e6, 1e6]]))
    np.testing.assert_allclose(found, [[0, 0, 0], [0.5, -0.2, 6]], atol=1e-4)


@pytest.mark.parametrize(
    ("missed", "depth", "expected"),
    [(0.0, 1.0, 0.5), (2 / 128, 1.0, 0.25), (4 / 128, 1.0, 0.1), (0.0, 2.0, 0.125), (2 / 128, 0.5, 1.0)],
)
def test_weights_by_hand(missed: float, depth: float, expected: float) -> None:
    """Of a link that counts 0.5, where 2 units may be missed: half at 2, a fifth at 4, over the depth squared."""
    given = (np.array([[value]]) for value in (0.5, missed, depth))
    assert weights(*given, 2 / 128)[0, 0] == pytest.approx(expected)

"""Where points lie: by cameras that are known, each by its own links."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from decomotion.data.structure.places import frames_to_place_by, place

Floats = npt.NDArray[np.floating]
UNIT = 1 / 128
OWN = 4
"""The points' own frame, of eleven."""
GAP = np.arange(11) - OWN
X = np.array([[0.3, -0.2, 0.4], [-0.5, 0.1, -0.3], [0.0, 0.25, 0.1]])


def cameras() -> Floats:
    """They move to the right and on."""
    found = np.tile(np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0.3, 1]]), (len(GAP), 1, 1))
    found[:, 0, 2], found[:, 2, 3] = 0.1 * GAP, 1
    found[:, 1, 2] = 0.02 * GAP**2
    return found


def projected(x: Floats) -> Floats:
    """[point, frame, 2]"""
    seen = np.einsum("tij,nj->nti", cameras(), np.concatenate([x, np.ones((len(x), 1))], axis=1))
    return seen[..., :2] / seen[..., 2:]


def slopes(x: Floats) -> Floats:
    """[frame, 2, 3], of where one point is seen by its place, by small steps."""
    steps = 1e-5 * np.eye(3)
    return np.moveaxis((projected(x + steps) - projected(x - steps)) / 2e-5, 0, -1)


def test_links_that_agree_tell_the_place() -> None:
    x, _, agreement = place(projected(X), np.ones((3, 11)), cameras(), GAP)
    np.testing.assert_allclose(x, X, atol=1e-3)  # a ridge holds them at the origin
    np.testing.assert_allclose(agreement, 1, atol=1e-3)


def test_a_place_is_as_uncertain_as_links_that_are_off_by_a_third_of_a_unit_make_it() -> None:
    """Own places count as ten links; links that hit all the same are taken to be 0.3 units off."""
    counts = np.random.default_rng(0).uniform(0.2, 1, (3, 11))
    _, covariance, _ = place(projected(X), counts, cameras(), GAP)
    for point in range(3):
        weight = np.where(GAP == 0, 10, counts[point])
        slope = slopes(X[point])
        normal = np.einsum("t,tki,tkj->ij", weight, slope, slope) + 1e-5 * np.eye(3)
        np.testing.assert_allclose(covariance[point], (0.3 * UNIT) ** 2 * np.linalg.inv(normal), rtol=0.05)


def test_links_that_are_worse_make_it_more_uncertain() -> None:
    """By the mean square of what they miss, each point by its own."""
    noise = np.random.default_rng(2).normal(scale=UNIT, size=(3, 11, 2)) * np.array([0, 0.5, 1.5])[:, None, None]
    noise[:, OWN] = 0
    _, calm, _ = place(projected(X), np.ones((3, 11)), cameras(), GAP)
    _, found, _ = place(projected(X) + noise, np.ones((3, 11)), cameras(), GAP)
    times = np.trace(found, axis1=1, axis2=2) / np.trace(calm, axis1=1, axis2=2)
    assert times[0] == pytest.approx(1, rel=1e-6)
    assert 1.2 < times[1] < 6
    assert 10 < times[2] < 60


def test_agreement_is_the_share_of_links_that_lead_there() -> None:
    """Of ten one misses by 2 units, and counts half, one by 40. Its own frame is not among them."""
    seen = projected(X)
    seen[0, 7, 1] += 2 * UNIT
    seen[1, 7, 1] += 40 * UNIT
    _, _, agreement = place(seen, np.ones((3, 11)), cameras(), GAP)
    np.testing.assert_allclose(agreement, [0.95, 0.9, 1], atol=0.015)
    counts = np.ones((3, 11))
    counts[:, 7] = 0.1
    _, _, agreement = place(seen, counts, cameras(), GAP)
    np.testing.assert_allclose(agreement, [1 - 0.05 / 9.1, 1 - 0.1 / 9.1, 1], atol=0.004)


@pytest.mark.parametrize(("links", "enough"), [(5, False), (6, True)])
def test_five_links_tell_nothing(links: int, enough: bool) -> None:
    counts = np.zeros((3, 11))
    counts[:, [0, 1, 2, 3, 5, 6][:links]] = 0.5
    counts[:, OWN] = 1
    x, covariance, agreement = place(projected(X), counts, cameras(), GAP)
    np.testing.assert_allclose(agreement, 1 if enough else 0, atol=1e-3)
    assert np.isfinite(x).all()
    assert np.isfinite(covariance).all()


@pytest.mark.parametrize("back", [False, True])
def test_near_links_say_first_what_far_ones_must_agree_with(back: bool) -> None:
    """In the farther frames, more than half, they hold on to one thing that is 40 units beside the point."""
    gap, other = np.arange(17), 10
    gap = -gap if back else gap
    moving = np.tile(cameras()[:1], (17, 1, 1))
    moving[:, 0, 2], moving[:, 1, 2] = 0.05 * gap, 0.0
    ones = np.ones((3, 1))
    seen = np.einsum("tij,nj->nti", moving, np.concatenate([X, ones], axis=1))
    seen = seen[..., :2] / seen[..., 2:]
    beside = np.einsum("tij,nj->nti", moving, np.concatenate([X + np.array([0, 0, 0.6]), ones], axis=1))
    beside = beside[..., :2] / beside[..., 2:]
    counts = np.ones((3, 17))
    seen[:, other - 3 :] = beside[:, other - 3 :] + np.array([0, 40 * UNIT])
    x, _, agreement = place(seen, counts, moving, gap)
    np.testing.assert_allclose(x, X, atol=0.05)
    np.testing.assert_allclose(agreement, 6 / 16, atol=0.03)


def test_a_point_stays_where_it_is_in_its_own_frame() -> None:
    """Which counts as ten links: all others are 1.5 units lower."""
    seen = projected(X)
    seen[:, np.arange(11) != OWN, 1] += 1.5 * UNIT
    x, _, _ = place(seen, np.ones((3, 11)), cameras(), GAP)
    off = (projected(x) - projected(X))[:, OWN, 1] / UNIT
    assert (off < 0.75).all()
    assert (off > 0.2).all()


def test_of_long_clips_some_frames() -> None:
    """All of forty; of more eight on either side, and so many of the others that there are not many more."""
    assert frames_to_place_by(5, 40).tolist() == list(range(40))
    assert frames_to_place_by(20, 41).tolist() == [*range(0, 12, 2), *range(12, 29), *range(30, 41, 2)]
    assert frames_to_place_by(0, 100).tolist() == [*range(9), *range(10, 100, 5)]


def sideways(gap: npt.NDArray[np.integer]) -> Floats:
    """Cameras without perspective that move to the right: what has Z = 1 by 6.4 units a frame."""
    found = np.tile(np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]]), (len(gap), 1, 1))
    found[:, 0, 2] = 0.05 * gap
    return found


@pytest.mark.parametrize("back", [False, True])
def test_what_hides_a_point_late_is_not_taken_for_it_though_it_moves_more(back: bool) -> None:
    """It is seen where the point was, passes it by 2.5 units a frame, and is farther away by far: least squares of all
    links, each as it counts, would be its."""
    gap = np.array([*range(9), *range(12, 17)]) * (-1 if back else 1)
    seen, covering = (
        np.einsum("tij,nj->nti", sideways(gap), np.concatenate([x, np.ones((3, 1))], axis=1))[..., :2]
        for x in (X, X + np.array([0, 0, 2.5 / 6.4]))
    )
    seen[:, 9:] = covering[:, 9:]
    x, _, agreement = place(seen, np.ones((3, 14)), sideways(gap), gap)
    np.testing.assert_allclose(x, X, atol=0.02)
    np.testing.assert_allclose(agreement, 8 / 13, atol=0.02)


def test_a_place_is_as_uncertain_as_its_links_miss_it() -> None:
    """In the mean square, by what they weigh: what they count, less what they miss at 2 units, and 10 of its own."""
    counts = np.random.default_rng(0).uniform(0.2, 1, (3, 11))
    noise = np.random.default_rng(2).normal(scale=1.5 * UNIT, size=(3, 11, 2))
    seen = np.einsum("tij,nj->nti", sideways(GAP), np.concatenate([X, np.ones((3, 1))], axis=1))[..., :2] + noise
    x, covariance, _ = place(seen, counts, sideways(GAP), GAP)
    expected = np.einsum("tij,nj->nti", sideways(GAP), np.concatenate([x, np.ones((3, 1))], axis=1))[..., :2]
    slope = sideways(GAP)[:, :2, :3]
    for point in range(3):
        missed = np.linalg.norm(expected[point] - seen[point], axis=-1) / UNIT
        weight = np.where(GAP == 0, 10, counts[point]) / (1 + (missed / 2) ** 2)
        square = (weight * missed**2).sum() / weight.sum() * UNIT**2
        normal = np.einsum("t,tki,tkj->ij", weight, slope, slope) + 1e-5 * np.eye(3)
        np.testing.assert_allclose(covariance[point], square * np.linalg.inv(normal), rtol=0.02, atol=1e-9)

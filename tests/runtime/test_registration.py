"""Patches are found where they are, and how sure that is can be told."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from decomo_runtime.registration import Pyramid, _step, cut, judge, pyramid, register
from moving_planes import HEIGHT, WIDTH, texture

PLACES = np.array([[120.0, 60.0], [333.3, 99.7], [500.5, 150.25], [640.0, 80.0]], np.float32)
MIDDLE = np.array([WIDTH / 2, HEIGHT / 2])


def moved(turn: float, zoom: float, shift: tuple[float, float]) -> npt.NDArray[np.float64]:
    """[2, 3], about the middle of the frame."""
    matrix = np.asarray(cv2.getRotationMatrix2D(tuple(MIDDLE), turn, zoom), np.float64)
    matrix[:, 2] += shift
    return matrix


def seen(matrix: npt.NDArray[np.float64], levels: int, gain: float = 1.0, bias: float = 0.0) -> Pyramid:
    picture = cv2.warpAffine(texture(1)[..., 0], matrix, (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC)
    return pyramid(np.rint(gain * picture + bias).clip(0, 255).astype(np.uint8), levels)


def jacobians(matrix: npt.NDArray[np.float64]) -> npt.NDArray[np.float32]:
    return np.repeat(matrix[None, :, :2], len(PLACES), axis=0).astype(np.float32)


STILL = moved(0, 1, (0, 0))


@pytest.mark.parametrize("light", [(1.0, 0.0), (0.6, 30.0)])
@pytest.mark.parametrize(
    ("turn", "zoom", "shift"), [(0, 1, (0, 0)), (0, 1, (7.3, -4.6)), (40, 1.3, (2.5, 1)), (-90, 0.8, (0, 0))]
)
def test_found_from_five_pixels_away(turn: float, zoom: float, shift: tuple[float, float], light: tuple[float, float]):
    matrix = moved(turn, zoom, shift)
    true = PLACES @ matrix[:, :2].T + matrix[:, 2]
    inside = ((true > 12) & (true < np.array([WIDTH, HEIGHT]) - 13)).all(1)
    patches = cut(seen(STILL, 3), PLACES, jacobians(STILL))
    match = register(
        patches, seen(matrix, 3, *light), (true + np.array([3.0, -4.0])).astype(np.float32), jacobians(matrix), 3
    )
    assert inside.any()
    np.testing.assert_allclose(match.xy[inside], true[inside], atol=0.06)
    assert (match.unexplained[inside] < 0.05).all()
    assert (match.deviation[inside] < 0.1).all()


def test_only_the_levels_asked_for_are_searched():
    patches, images = cut(seen(STILL, 3), PLACES, jacobians(STILL)), seen(STILL, 3)
    start = PLACES + np.float32(6)
    assert (np.abs(register(patches, images, start, jacobians(STILL), 3).xy - PLACES) < 0.05).all()
    assert (np.abs(register(patches, images, start, jacobians(STILL), 1).xy - PLACES) > 1).any()


def test_judged_by_hand():
    """The share of the variance that a patch leaves is 1 - r^2; r by numpy, over pixels that weigh the same."""
    grey = np.random.default_rng(0).integers(0, 256, (64, 64)).astype(np.uint8)
    images, other = pyramid(grey, 1), pyramid(np.roll(grey, 1, axis=0), 1)
    place, upright = np.array([[30.0, 30.0]], np.float32), np.eye(2, dtype=np.float32)[None]
    judged = judge(cut(images, place, upright, np.ones(15 * 15, np.float32)), other, place, upright)
    r = np.corrcoef(images[0][23:38, 23:38].ravel(), other[0][23:38, 23:38].ravel())[0, 1]
    assert judged.unexplained[0] == pytest.approx(1 - r**2, abs=1e-4)


def test_noise_moves_what_has_texture_in_one_direction_only():
    noise = np.random.default_rng(0).normal(0, 2, (2, HEIGHT, WIDTH))
    stripes = 128 + 60 * np.sin(np.arange(WIDTH) / 2.5) + 0 * noise
    here, there = (pyramid(np.rint(picture).astype(np.uint8), 1) for picture in stripes + noise)
    texture_here, texture_there = (
        pyramid(np.rint(texture(1)[..., 0] + each).clip(0, 255).astype(np.uint8), 1) for each in noise
    )
    upright = jacobians(STILL)
    along = judge(cut(here, PLACES, upright), there, PLACES, upright)
    both = judge(cut(texture_here, PLACES, upright), texture_there, PLACES, upright)
    assert (along.unexplained < 0.05).all()
    assert (along.deviation > 3 * both.deviation).all()


def test_what_lies_outside_of_the_frame_tells_nothing():
    patches = cut(seen(STILL, 1), PLACES, jacobians(STILL))
    for place, told in (((3.0, 99.0), True), ((-4.0, 99.0), False), ((WIDTH + 300.0, 99.0), False)):
        match = judge(patches, seen(STILL, 1), np.full_like(PLACES, place), jacobians(STILL))
        assert (np.isfinite(match.deviation) == told).all()
        assert told or (match.unexplained == 1).all()


def test_no_points():
    none, images = np.empty((0, 2), np.float32), seen(STILL, 2)
    match = register(
        cut(images, none, np.empty((0, 2, 2), np.float32)), images, none, np.empty((0, 2, 2), np.float32), 2
    )
    assert match.xy.shape == (0, 2)
    assert match.unexplained.shape == match.deviation.shape == (0,)


def test_how_sure_a_match_is_by_plain_numbers():
    """In half the light, by a loop: the noise left over, over what a patch's gradients tell in its worst direction."""
    random = np.random.default_rng(2)
    grey = cv2.GaussianBlur(random.uniform(0, 255, (64, 80)).astype(np.float32), (0, 0), 2) * 3 - 256
    other = 0.5 * grey + 40 + random.normal(0, 3, grey.shape)
    here, there = ([each.clip(0, 255).astype(np.float32)] for each in (grey, other))
    place, upright = np.array([[37.0, 30.0]], np.float32), np.eye(2, dtype=np.float32)[None]
    found = judge(cut(here, place, upright), there, place, upright)
    rows, weights = [], []
    for y in range(23, 38):
        for x in range(30, 45):
            across = (here[0][y, x + 1] - here[0][y, x - 1]) / 2
            down = (here[0][y + 1, x] - here[0][y - 1, x]) / 2
            rows.append((across, down, here[0][y, x], there[0][y, x]))
            weights.append(np.exp(-((x - 37) ** 2 + (y - 30) ** 2) / (2 * 4.2**2)))
    across, down, patch, seen = np.array(rows, np.float64).T
    weight = np.array(weights)
    share = weight / weight.sum()
    patch, seen = patch - share @ patch, seen - share @ seen
    gain = (share * patch) @ seen / ((share * patch) @ patch)
    left = (share * (seen - gain * patch)) @ (seen - gain * patch)
    assert 0.4 < gain < 0.6
    assert found.unexplained[0] == pytest.approx(left / ((share * seen) @ seen), rel=1e-3)
    noise = np.sqrt(left) / gain
    tensor = np.array([[(weight * a) @ b for a in (across, down)] for b in (across, down)])
    least = np.linalg.eigvalsh(tensor)[0] - weight.sum() * noise**2 / 3
    assert found.deviation[0] == pytest.approx(noise / np.sqrt(least), rel=1e-2)


def test_a_step_is_as_long_in_half_the_light():
    """It leads most of the way from half a pixel beside."""
    patches, upright = cut(seen(STILL, 1), PLACES, jacobians(STILL)), jacobians(STILL)
    beside, rows = PLACES + np.float32([0.4, -0.3]), np.arange(len(PLACES))
    steps = [_step(patches, seen(STILL, 1, gain, 20), 0, beside, upright, rows) for gain in (1.0, 0.5)]
    np.testing.assert_allclose(steps[0], np.broadcast_to([-0.4, 0.3], (4, 2)), atol=0.15)
    np.testing.assert_allclose(steps[1], steps[0], atol=0.03)  # grey values are whole numbers


def test_a_negative_is_not_alike():
    place, upright = PLACES, jacobians(STILL)
    patches = cut(seen(STILL, 1), place, upright)
    np.testing.assert_array_equal(judge(patches, seen(STILL, 1, -1, 255), place, upright).unexplained, 1)

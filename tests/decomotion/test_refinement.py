"""Refinement of matches: to a fraction of a pixel where there is texture, left alone where there is none."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from decomotion.clip import Clip
from decomotion.data.links.refinement import Refiner

SHIFT = np.array([9.3, -4.6], np.float32)
HEIGHT, WIDTH = 96, 128


def moved_texture(scale: int) -> Clip:
    """Two frames of smooth noise, the second moved by SHIFT (for 128x96); a plain square is cut out of the middle."""
    size = (WIDTH * scale, HEIGHT * scale)
    noise = np.random.default_rng(0).integers(0, 256, (HEIGHT // 3, WIDTH // 3), np.uint8)
    image = cv2.resize(noise, size, interpolation=cv2.INTER_CUBIC)
    image[40 * scale : 72 * scale, 48 * scale : 80 * scale] = 128
    move = np.float32([[1, 0, SHIFT[0] * scale], [0, 1, SHIFT[1] * scale]])
    frames = [image, cv2.warpAffine(image, move, size, flags=cv2.INTER_CUBIC)]
    return Clip("noise", np.stack([np.repeat(frame[..., None], 3, axis=-1) for frame in frames]), 24.0)


@pytest.mark.parametrize("scale", [1, 5])  # frames that are enlarged and frames that are reduced
def test_what_has_texture_is_found_to_a_fraction_of_a_pixel(scale: int):
    refine = Refiner(moved_texture(scale))
    xy = np.array([[20, 30], [30.5, 70.25], [100, 50]], np.float32)
    off = np.array([[0.8, -0.7], [-0.9, 0.5], [0.2, 1.0]], np.float32)
    found = refine(0, 1, xy, xy + SHIFT + off, (HEIGHT, WIDTH))
    np.testing.assert_allclose(found, xy + SHIFT, atol=0.06)
    assert found.dtype == np.float32
    back = refine(1, 0, xy + SHIFT, xy + off, (HEIGHT, WIDTH))
    np.testing.assert_allclose(back, xy, atol=0.06)


def test_positions_are_those_of_the_raster():
    refine = Refiner(moved_texture(1))
    xy, half = np.array([[20, 30]], np.float32), np.array([[9.75, 14.75]], np.float32)  # the same place
    whole = refine(0, 1, xy, xy + SHIFT + 0.5, (HEIGHT, WIDTH))
    coarse = refine(0, 1, half, half + (SHIFT + 0.5) / 2, (HEIGHT // 2, WIDTH // 2))
    np.testing.assert_allclose((coarse + 0.5) * 2 - 0.5, whole, atol=1e-3)


def test_what_has_none_or_leads_too_far_stays():
    refine = Refiner(moved_texture(1))
    xy = np.array([[64, 56], [20, 30], [20, 30], [-30, 4]], np.float32)
    off = np.array([[0.5, 0.5], [20, 20], [5, 0], [0, 0]], np.float32)
    found = refine(0, 1, xy, xy + SHIFT + off, (HEIGHT, WIDTH))
    assert np.linalg.norm(found - (xy + SHIFT + off), axis=-1).max() <= 2.5 * WIDTH / 256 + 1e-3
    np.testing.assert_array_equal(found[0], (xy + SHIFT + off)[0])


def test_no_points():
    none = np.zeros((0, 2), np.float32)
    assert Refiner(moved_texture(1))(0, 1, none, none, (HEIGHT, WIDTH)).shape == (0, 2)


@pytest.mark.parametrize("scale", [1, 5])
@pytest.mark.parametrize(("units", "taken"), [(2.3, True), (2.7, False)])
def test_a_place_is_moved_by_two_and_a_half_units_at_most(scale: int, units: float, taken: bool):
    """A unit is half a pixel of a raster of 128x96."""
    refine = Refiner(moved_texture(scale))
    xy = np.array([[20, 30], [30.5, 70.25], [100, 50]], np.float32)
    start = xy + SHIFT + units / 2 * np.array([[1, 0], [0, -1], [-0.6, 0.8]], np.float32)
    found = refine(0, 1, xy, start, (HEIGHT, WIDTH))
    np.testing.assert_allclose(found, xy + SHIFT if taken else start, atol=0.06 if taken else 1e-5)


def test_a_raster_may_have_other_pixels_across_than_down():
    refine = Refiner(moved_texture(1))
    places, raster = np.array([[20, 30], [100, 70]], np.float32), np.array([0.5, 0.25], np.float32)
    xy = (places + 0.5) * raster - 0.5
    found = refine(0, 1, xy, xy + (SHIFT + 0.6) * raster, (HEIGHT // 4, WIDTH // 2))
    np.testing.assert_allclose((found + 0.5) / raster - 0.5, places + SHIFT, atol=0.06)


def test_what_differs_in_colour_is_seen_as_bright_as_it_looks():
    """Red of 170 is as bright as green of 87, so that where one passes into the other there is no texture."""
    chance = np.random.default_rng(0).random((HEIGHT // 3, WIDTH // 3)).astype(np.float32)
    red = cv2.resize(chance, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC).clip(0, 1)
    still = np.stack([170 * red, 0.299 / 0.587 * 170 * (1 - red), np.zeros_like(red)], axis=-1)
    moved = np.roll(still, 1, axis=1)
    refine = Refiner(Clip("colours", np.rint([still, moved]).astype(np.uint8), 24.0))
    xy = np.array([[20, 30], [60, 50], [100, 40]], np.float32)
    found = refine(0, 1, xy, xy, (HEIGHT, WIDTH))
    assert np.abs(found - xy - (1, 0)).max() > 0.5, "by red and blue exchanged it would be found"

"""What tools that go frame by frame are given: frames in order, which points are in the frame, names of images."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from decomo_runtime import About, Tracks, TracksFileError
from decomo_runtime.formats.frames import image_names, in_frame, in_order, likelihood

WIDTH, HEIGHT = 90, 50


def told_by_frame(frames: list[int]) -> Tracks:
    """Two points, of which all that is said in a frame says the frame's number."""
    numbers = np.array(frames)
    each = np.stack([numbers, numbers + 100])
    return Tracks(
        np.stack([each, each + 0.5], axis=-1).astype(np.float32),
        each % 2 == 1,
        (each / 1000).astype(np.float32),
        np.array([[frames[0], 1, 2], [frames[0], 3, 4]], np.float32),
        numbers,
        (HEIGHT, WIDTH),
        numbers / 25,
        each % 3 == 0,
        each.astype(np.float32),
    )


def test_frames_rise_and_each_is_there_once_with_all_that_is_known_of_it():
    found, expected = in_order(told_by_frame([7, 3, 7, 12, 4, 3])), told_by_frame([3, 4, 7, 12])
    for name in ("frames", "times", "xy", "occluded", "occlusion", "refined", "error"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=name)


@pytest.mark.parametrize(
    ("x", "y", "inside"),
    [
        *((-0.5, 20, True), (-0.51, 20, False), (89.5, 20, True), (89.51, 20, False)),
        *((20, -0.5, True), (20, -0.51, False), (20, 49.5, True), (20, 49.51, False)),
        *((60, 60, False), (np.nan, 20, False)),
    ],
)
def test_the_frame_ends_half_a_pixel_around_the_outer_pixels_centres(x: float, y: float, inside: bool):
    tracks = Tracks(
        np.array([[[x, y]]], np.float32),
        *(np.zeros((1, 1), bool), np.zeros((1, 1), np.float32), np.zeros((1, 3), np.float32), np.arange(1)),
    )
    assert in_frame(tracks, About(size=(HEIGHT, WIDTH))).tolist() == [[inside]]


def test_what_may_be_hidden_or_not_is_not_likely():
    """Files of others may have no score, or one that is no share."""
    occlusion = np.array([[np.nan, 0.25, -3, 7]], np.float32)
    tracks = Tracks(
        np.zeros((1, 4, 2), np.float32), occlusion > 0.5, occlusion, np.zeros((1, 3), np.float32), np.arange(4)
    )
    np.testing.assert_array_equal(likelihood(tracks, About()), [[0, 0.75, 1, 0]])


@pytest.mark.parametrize("frame", [-1, 3])
def test_there_are_no_images_beyond_the_clip(tmp_path: Path, frame: int):
    for number in range(3):
        cv2.imwrite(str(tmp_path / f"{number + 5}.png"), np.zeros((HEIGHT, WIDTH, 3), np.uint8))
    about = About(clip=tmp_path)
    assert image_names(about, np.array([0, 2])) == ["5.png", "7.png"]
    with pytest.raises(TracksFileError, match=rf"has frames 0 to 2, but there are tracks in {frame}$"):
        image_names(about, np.array([1, frame]))


@pytest.mark.parametrize(("count", "last"), [(1, "point_00"), (100, "point_99"), (101, "point_100")])
def test_names_have_as_many_digits_as_the_last_needs(count: int, last: str):
    names = About().names(count)
    assert names[-1] == last
    assert {len(name) for name in names} == {len(last)}

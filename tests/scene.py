"""One moving scene, photographed in many ways: at several sizes, lying or standing, backwards, in other colours.

Lengths are in pixels of the smallest photograph, 48 x 36, and positions in it have pixel centres at integers.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

FINE = 6
"""The scene is painted with this many pixels to one of the smallest photograph; sizes are divisors of it."""
FRAMES, HEIGHT, WIDTH = 7, 36, 48
SCENE_VELOCITY, OBJECT_VELOCITY = np.array([-1.0, 1 / 3]), np.array([1.5, -0.5])
"""A frame, (x, y)."""
OBJECT_START, OBJECT_SIZE = np.array([6.0, 14.0]), np.array([14.0, 11.0])
"""Upper left corner in frame 0, from the image's corner."""

Video = npt.NDArray[np.uint8]


def photographed(size: int, shift: tuple[int, int] = (0, 0)) -> Video:
    """Frames [T, 36 size, 48 size, 3]; with `shift` the camera looks so many pixels further right and down."""
    random = np.random.default_rng(5)
    margin = 14 * FINE
    ground = _painted(random, HEIGHT * FINE + 2 * margin, WIDTH * FINE + 2 * margin)
    thing = _painted(random, *(OBJECT_SIZE[::-1] * FINE).astype(int))
    frames = []
    for frame in range(FRAMES):
        left, up = (margin + (np.array(shift) - frame * SCENE_VELOCITY) * FINE).round().astype(int)
        picture = ground[up : up + HEIGHT * FINE, left : left + WIDTH * FINE].copy()
        x, y = ((OBJECT_START + frame * OBJECT_VELOCITY - np.array(shift)) * FINE).round().astype(int)
        picture[y : y + thing.shape[0], x : x + thing.shape[1]] = thing
        frames.append(cv2.resize(picture, (WIDTH * size, HEIGHT * size), interpolation=cv2.INTER_AREA))
    return np.stack(frames).astype(np.uint8)


def on_object(xy: npt.NDArray[np.floating], margin: float = 0.0) -> npt.NDArray[np.bool_]:
    """Whether places [..., 2] of frame 0 lie on the object, so far from its outline; negative: or near it."""
    from_corner = xy + 0.5 - OBJECT_START
    return np.asarray(((from_corner > margin) & (from_corner < OBJECT_SIZE - margin)).all(-1))


def true_tracks(xy: npt.NDArray[np.floating]) -> npt.NDArray[np.float64]:
    """Where places [N, 2] of frame 0 lie in every frame, [N, T, 2]."""
    velocity = np.where(on_object(xy)[:, None], OBJECT_VELOCITY, SCENE_VELOCITY)
    return xy[:, None] + np.arange(FRAMES)[:, None] * velocity[:, None]


def _painted(random: np.random.Generator, height: int, width: int) -> Video:
    noise = sum(
        weight * _standardised(cv2.GaussianBlur(random.random((height, width, 3), np.float32), (0, 0), grain * FINE))
        for grain, weight in ((0.8, 1.0), (2.5, 1.0))
    )
    return np.clip(128 + 45 * noise, 0, 255).astype(np.uint8)


def _standardised(values: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    return (values - values.mean()) / values.std()

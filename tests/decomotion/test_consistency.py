"""One scene for a whole clip, where objects fill frames and hide it: masks and the camera hold."""

from __future__ import annotations

import numpy as np
import pytest

from decomotion.data import camera
from decomotion.data.masks import consistency
from decomotion.data.masks.auto import moves_at, moving_probability
from decomotion.data.masks.links import Links
from decomotion.units import unit
from layers import Layer, Layered, Map, filmed, placed, through


def panning(x: float, y: float) -> Layer:
    return Layer(lambda frame: placed(20 + x * frame, 30 + y * frame))


def passing(frame: int) -> Map:
    """Turns, and is out of sight at first, over the whole frame for a third of 24, and out of sight at last."""
    return placed(-150 + 17 * frame, 36, turn=0.04 * (frame - 12))


def halting(frame: int) -> Map:
    """The same, seen from a camera that goes with it while it is in front."""
    return placed(52 + 36 * (min(frame, 9) - 9 + max(frame, 18) - 18), 36, turn=0.04 * (frame - 14))


def growing(speed: float) -> Layer:
    """Eightfold within 14 frames."""
    return Layer(lambda frame: placed(40 + speed * frame, 36, scale=8 ** min(1, frame / 14)), (14, 16))


def crossing(frame: int) -> Map:
    return placed(20 + 2.5 * frame, 30)


def opposite(x: float, y: float, speed: float) -> Layer:
    return Layer(lambda frame: placed(x + speed * frame, y, turn=0.03 * frame), (30, 56))


KINDS = {
    "grows eightfold and covers the scene": (24, [panning(-3, 0.6), growing(1.0)]),
    "so it does, the camera with it": (24, [panning(-5, 0.6), growing(0.0)]),
    "the scene leaves the frame in a pan": (24, [panning(-11, 1.5), Layer(lambda _: placed(52, 36), (26, 20))]),
    "the camera rolls by a right angle": (
        24,
        [Layer(lambda frame: placed(52, 36, turn=np.pi / 2 * frame / 23)), Layer(crossing, (26, 20))],
    ),
    "the camera zooms": (
        24,
        [Layer(lambda frame: placed(52, 36, scale=2.5 ** (frame / 23))), Layer(crossing, (26, 20))],
    ),
    "two of opposite motion, as large as the scene": (
        24,
        [Layer(lambda frame: placed(52, 36 + 0.3 * frame)), opposite(30, 16, 1), opposite(74, 56, -1)],
    ),
    "no scene in sight for a third of the clip": (24, [panning(1.5, 0.5), Layer(passing, (140, 220))]),
    "nor where the camera follows what hides it": (30, [panning(-6, 0.5), Layer(halting, (140, 130))]),
}


def masks_of(clip: Layered) -> np.ndarray:
    """[frame, point]"""
    linked = (clip.frames, clip.points, clip.targets, clip.confidence, clip.grid, clip.sides)
    probability = moving_probability(*linked, np.random.default_rng(0))
    return np.stack([moves_at(each, xy, clip.sides) for each, xy in zip(probability, clip.points, strict=True)])


@pytest.mark.parametrize("kind", KINDS)
def test_masks_and_camera_hold(kind: str):
    count, layers = KINDS[kind]
    clip = filmed(layers, count)
    moving, truth = masks_of(clip), clip.owner > 0
    assert (moving == truth).mean() > 0.95
    assert ((moving == truth).mean(axis=1) > 0.9).all()
    maps = camera.chain(clip.points, clip.targets, clip.confidence, ~moving, unit(*clip.sides))
    height, width = clip.sides
    corners = np.array([[0, 0], [width - 1, 0], [0, height - 1], [width - 1, height - 1]])
    last = np.flatnonzero((~truth).mean(axis=1) > 0.1).max()  # after it the scene is not seen again
    for frame in range(last + 1):
        to_middle = camera.compose(layers[0].at(count // 2), camera.invert(layers[0].at(frame)))
        # the camera's motion is not steady while nothing of it is seen
        assert np.abs(through(maps[frame], corners) - through(to_middle, corners)).max() < 3


def test_labels_are_carried_to_where_nothing_is_known():
    """From the first and the last frame to those between, each to what is linked with it."""
    clip = filmed([panning(1.0, 0.0), Layer(lambda frame: placed(52 - frame, 36), (40, 50))], 9, points=600)
    links = Links(clip.points, clip.targets, clip.confidence, clip.grid, clip.sides)
    known, truth = np.zeros(clip.owner.shape, np.bool_), np.where(clip.owner > 0, 1, -1).astype(np.float32)
    known[[0, 8]] = True
    spins = consistency.carried(np.where(known, truth, 7).astype(np.float32), known, links)
    np.testing.assert_array_equal(spins[known], truth[known])
    heard = spins[4] != 0
    assert heard.mean() > 0.9
    assert (np.sign(spins[4]) == truth[4])[heard].mean() > 0.95
    assert not consistency.carried(truth, np.zeros_like(known), links).any()

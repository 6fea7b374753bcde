"""The closed forms that strain is measured against agree with themselves and with their pictures."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from harness.deformations import DEFORMATIONS, Deformation, Deformed


@pytest.mark.parametrize("deformation", DEFORMATIONS, ids=lambda each: each.name)
def test_closed_forms(deformation: Deformation):
    clip = Deformed(deformation, 5, 60, 84)
    places = np.random.default_rng(0).uniform(0, 60, (9, 2))
    np.testing.assert_allclose(clip.follow(places, 0), places)
    np.testing.assert_allclose(clip.gradient(places, 0), np.broadcast_to(np.eye(2), (9, 2, 2)))
    for frame in (2, 4):
        there = clip.follow(places, frame) - clip.middle
        np.testing.assert_allclose(deformation.back(there, clip.amount(frame)), places - clip.middle, atol=1e-9)
        steps = 1e-5 * np.eye(2)
        ends = [(clip.follow(places + step, frame) - clip.follow(places - step, frame)) / 2e-5 for step in steps]
        np.testing.assert_allclose(clip.gradient(places, frame), np.stack(ends, axis=-1), atol=1e-6)


@pytest.mark.parametrize("deformation", DEFORMATIONS, ids=lambda each: each.name)
def test_pictures_move_as_they_say(deformation: Deformation):
    clip = Deformed(deformation, 3, 60, 84)
    first, _, last = clip.frames()
    y, x = np.mgrid[20:40, 30:54].astype(float)
    there = clip.follow(np.stack([x, y], axis=-1), 2).astype(np.float32)
    seen = cv2.remap(last, there[..., 0], there[..., 1], cv2.INTER_CUBIC).astype(float)
    assert np.abs(seen - first[20:40, 30:54]).mean() < 4
    assert np.abs(last[20:40, 30:54].astype(float) - first[20:40, 30:54]).mean() > 8

"""Errors of strain: none of exact answers but what a square averages, and those of answers that are known to be off."""

from __future__ import annotations

import numpy as np
import pytest

from decomo_runtime import ModelFacts
from harness.deformations import DEFORMATIONS, Deformation, Deformed
from strain import GivenTracker, errors_of

CLIP = {"num_frames": 8, "height": 130, "width": 150}


def tracked(clip: Deformed, stretched: float = 1.0) -> GivenTracker:
    facts = ModelFacts("clip", clip.num_frames, clip.height, clip.width, 24.0, "cpu", 0.5)

    def places(start: np.ndarray) -> np.ndarray:
        there = np.stack([clip.follow(start, frame) for frame in range(clip.num_frames)], axis=1)
        return there * np.where(np.arange(clip.num_frames) > 0, stretched, 1.0)[:, None]

    return GivenTracker(facts, places)


@pytest.mark.parametrize("deformation", DEFORMATIONS, ids=lambda each: each.name)
def test_exact_answers(deformation: Deformation):
    clip = Deformed(deformation, **CLIP)
    found = errors_of(clip, tracked(clip), None)
    uniform = deformation.name != "wave"
    for side in ("8", "32"):
        assert found[side]["count"] > 0
        assert found[side]["hidden"] == found[side]["unknown"] == 0
        assert found[side]["strain"] < (1e-5 if uniform else 2e-2)
        assert found[side]["rotation"] < (1e-3 if uniform else 2)
    assert found["8"]["strain"] < 1e-3  # the wave's, averaged over little


def test_a_known_error():
    """Of answers that are 1% too large in a rotation: E is (1.01^2 - 1) / 2 along both axes, and 0 across."""
    clip = Deformed(DEFORMATIONS[2], **CLIP)
    found = errors_of(clip, tracked(clip, 1.01), None)
    assert found["32"]["strain"] == pytest.approx((1.01**2 - 1) / 2 * np.sqrt(2 / 3), rel=1e-3)
    assert set(found["32"]["by_strain"]) == {"0-0.003"}

"""What annotated frames teach of an object's looks, by the table that the page is held to too."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from decomo_runtime.propagation.evidence import Looks

CASES = json.loads((Path(__file__).parents[2] / "recorded" / "owner_looks.json").read_text())


@pytest.mark.parametrize("case", CASES, ids=[case["what"] for case in CASES])
def test_whose_pixels_are_the_objects(case: dict):
    moving, inside, asked = (np.array([case[key]], np.float32) for key in ("moving", "inside", "asked"))
    looks, black = Looks(2), np.zeros((*moving.shape, 3), np.float32)
    looks.add(0, 1 - inside, 1 - moving, black)
    looks.add(1, inside, 1 - moving, black)
    np.testing.assert_allclose(looks.by_owner(1 - asked)[1], [case["chances"]], atol=1e-4)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_colours_are_nearly_those_of_the_bin_beside(axis: int):
    """Bins are 16 wide along each axis of CIELAB; two bins away nothing is known, and all classes are as likely."""
    looks, middle = Looks(2), np.array([136, 136, 136])
    step = 16 * np.eye(3, dtype=int)[axis]

    def picture(bins: int) -> np.ndarray:
        colour = (middle + bins * step).astype(np.uint8)[None, None]
        return cv2.cvtColor(colour, cv2.COLOR_LAB2RGB).astype(np.float32) / 255

    looks.add(1, np.full((1, 1), 50, np.float32), np.zeros((1, 1), np.float32), picture(0))
    chances = [float(looks.by_colour(picture(bins))[1, 0, 0]) for bins in (-2, -1, 0, 1, 2)]
    np.testing.assert_allclose(chances, [0.5, 1, 1, 1, 0.5], atol=0.001)

"""What annotated frames teach of an object's looks, by the table that the page is held to too."""

from __future__ import annotations

import json
from pathlib import Path

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

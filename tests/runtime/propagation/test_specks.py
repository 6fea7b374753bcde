"""Specks of carried masks, by the table that the page is held to too."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from decomo_runtime.propagation.regions import without_specks

CASES = json.loads((Path(__file__).parents[2] / "recorded" / "specks.json").read_text())


def mask(rows: list[str]) -> np.ndarray:
    return np.array([[letter == "#" for letter in row] for row in rows])


@pytest.mark.parametrize("case", CASES, ids=[case["what"] for case in CASES])
def test_specks_are_left_out(case: dict):
    np.testing.assert_array_equal(without_specks(mask(case["given"])), mask(case["kept"]))

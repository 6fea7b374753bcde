"""Label PNGs, by the table that the page is held to too."""

from __future__ import annotations

import base64
import json
from pathlib import Path

import numpy as np
import pytest

from decomo_runtime.errors import AnnotationError
from decomo_runtime.propagation.formats import png
from decomo_runtime.propagation.formats.asked import ClipFacts

CASES = json.loads((Path(__file__).parents[2] / "recorded" / "label_pngs.json").read_text())
HEIGHT, WIDTH = 3, 5
CLIP = ClipFacts((HEIGHT, WIDTH), 1)


@pytest.mark.parametrize("case", CASES, ids=[case["what"] for case in CASES])
def test_labels_of_a_png(case: dict):
    content = base64.b64decode(case["png"])
    if case["labels"] is None:
        with pytest.raises(AnnotationError, match="colours without a palette"):
            png.read(Path("m.png"), content, 0, CLIP)
        return
    drawn = png.read(Path("m.png"), content, 0, CLIP)
    labels = np.zeros((HEIGHT, WIDTH), int)
    for shape in drawn.shapes:
        assert shape.mask is not None
        labels[shape.mask] = drawn.things[shape.thing].id
    np.testing.assert_array_equal(labels, case["labels"])

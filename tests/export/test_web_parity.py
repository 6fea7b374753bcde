"""The exported file in a browser's onnxruntime: the answers are those of Python's."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

pytest.importorskip("playwright.sync_api", reason="needs playwright: pip install playwright")
from playwright.sync_api import expect

from decomo_runtime import Tracker
from tiny_export import Export, random_queries
from view_page import opened

if TYPE_CHECKING:
    from playwright.sync_api import Browser

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("name", ["fitted", "unbaked", "whole", "folded", "networks", "canonical", "quantised"])
def test_browser_answers_as_python_does(chromium: Browser, name: str, tmp_path: Path, request: pytest.FixtureRequest):
    """However baked, in every precision."""
    exported: Export = request.getfixturevalue(name)
    queries = random_queries(40)
    text = "\n".join(["t,x,y", *(",".join(map(repr, map(float, query))) for query in queries)])
    (tmp_path / "queries.csv").write_text(f"{text}\n")
    with opened(chromium, tmp_path / "site", exported.path) as view:
        view.open(tmp_path / "queries.csv")
        expect(view.rows).to_have_count(len(queries))
        tracks = view.tracks(tmp_path)
    expected = Tracker(exported.path).track(queries)
    np.testing.assert_array_equal(tracks.queries, queries)
    np.testing.assert_allclose(tracks.xy, expected.xy, atol=0.01)
    np.testing.assert_allclose(tracks.occlusion, expected.occlusion, atol=0.01)

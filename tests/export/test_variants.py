"""Every kind of model that the configuration can describe goes the whole way: fit, export, ask."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from decomo_export import export
from decomo_export.parity import LIMIT_PIXELS
from decomo_runtime import Tracker
from decomotion import fit
from decomotion.config import load
from tiny_export import random_queries
from tiny_fit import TINY_PRESETS, sliding_square


@pytest.mark.parametrize(
    ("preset", "overrides"),
    [
        ("cpu", ("model.volumes=static",)),
        ("omnimotion", ()),
        ("cpu", ("model.static.couplings=0", "model.dynamic.couplings=0", "data.features=none")),
    ],
    ids=["static", "omnimotion", "affine"],
)
def test_from_fit_to_answer(preset: str, overrides: tuple[str, ...], tmp_path: Path):
    config = load(preset, overrides=(*TINY_PRESETS[preset], *overrides))
    run = fit(sliding_square(), tmp_path / "run", config=config, steps=3, progress=False)
    exported = export(tmp_path / "model.onnx", run)
    assert exported.parity.pixels < LIMIT_PIXELS
    assert exported.parity.score < 1e-3  # float32 through a few dozen layers
    tracker = Tracker(exported.path)
    queries = random_queries(5)
    queries[:, 1:] = queries[:, 1:].clip(0, 31)
    tracks = tracker.track(queries)
    assert np.isfinite(tracks.xy).all()
    at_home = tracks.xy[np.arange(5), queries[:, 0].astype(int)]
    # three steps have hardly moved anything: a query is where it was, but for samples averaged in a bent space
    np.testing.assert_allclose(at_home, queries[:, 1:], atol=0.5)

"""Exported models: one from a fit, baked in two ways, and one of the paper's networks with random weights."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path

import pytest

from decomo_export import cli, export
from decomotion import checkpoint
from decomotion.checkpoint import FILE_NAME, ClipFacts
from decomotion.config import load
from tiny_export import Export
from tiny_fit import FRAMES, SIZE, TINY_PAPER, randomised, sliding_square, tiny_model


@pytest.fixture(scope="session")
def fitted(tiny_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Export:
    """`decomo-export` on the run of `decomo-train`."""
    path = tmp_path_factory.mktemp("models") / "sliding.onnx"
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        assert cli.main([str(path), "--run", str(tiny_run)]) == 0
    return Export(path, tiny_run, said.getvalue())


@pytest.fixture(scope="session")
def networks(tmp_path_factory: pytest.TempPathFactory) -> Export:
    """A model with the paper's networks in the place of grids, its weights random, exported through Python."""
    folder = tmp_path_factory.mktemp("paper")
    model = randomised(tiny_model("paper", frames=FRAMES, height=SIZE, width=SIZE), 0.05)
    config = load("paper", overrides=TINY_PAPER)
    checkpoint.save(folder / FILE_NAME, config, ClipFacts.of(sliding_square()), model, {"step": 1})
    exported = export(folder / "model.onnx", folder, bake="none")
    return Export(exported.path, folder, "", "none")


@pytest.fixture(scope="session")
def canonical(fitted: Export, tmp_path_factory: pytest.TempPathFactory) -> Export:
    """The fit with its canonical coordinates baked, in half precision."""
    path = tmp_path_factory.mktemp("full") / "full.onnx"
    export(path, fitted.run, bake="full", precision="fp16", force=True)
    return Export(path, fitted.run, "", "full")


@pytest.fixture(params=["fitted", "networks"])
def exported(request: pytest.FixtureRequest) -> Export:
    """Either of the first two."""
    return request.getfixturevalue(request.param)

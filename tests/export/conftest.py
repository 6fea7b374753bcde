"""Exported models: a fit, baked in each way, and the paper's networks with random weights; in each precision."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable
from pathlib import Path

import onnx
import pytest

from decomo_export import cli, export, exporter, lookup
from decomo_export.baking import Bake
from decomo_export.precision import Precision
from decomotion import checkpoint
from decomotion.checkpoint import FILE_NAME, ClipFacts
from decomotion.config import load
from tiny_export import Export
from tiny_fit import FRAMES, HEIGHT, TINY_PAPER, WIDTH, randomised, sliding_square, tiny_model

TRACES: dict[tuple[Path, Bake], onnx.ModelProto] = {}


@pytest.fixture(scope="session")
def fitted(tiny_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Export:
    """`decomo-export` on the run of `decomo-train`."""
    path = tmp_path_factory.mktemp("models") / "sliding.onnx"
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        assert cli.main([str(path), "--run", str(tiny_run)]) == 0
    return Export(path, tiny_run, said.getvalue())


@pytest.fixture(scope="session")
def unbaked(fitted: Export, tmp_path_factory: pytest.TempPathFactory) -> Export:
    """The fit with nothing baked."""
    return exported_as(tmp_path_factory.mktemp("none") / "none.onnx", fitted.run, "none")


@pytest.fixture(scope="session")
def whole(fitted: Export, tmp_path_factory: pytest.TempPathFactory) -> Export:
    """The fit with its canonical coordinates baked."""
    return exported_as(tmp_path_factory.mktemp("full") / "full.onnx", fitted.run, "full")


@pytest.fixture(scope="session")
def folded(fitted: Export, tmp_path_factory: pytest.TempPathFactory) -> Export:
    """The fit with its tables left as they are, as those of a large model."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lookup, "MOST_UNFOLDED", 0)
        exported = export(tmp_path_factory.mktemp("folded") / "folded.onnx", fitted.run)
    return Export(exported.path, fitted.run, "")


@pytest.fixture(scope="session")
def canonical(whole: Export, tmp_path_factory: pytest.TempPathFactory) -> Export:
    """The same in half precision."""
    return exported_as(tmp_path_factory.mktemp("half") / "half.onnx", whole.run, "full", "fp16")


@pytest.fixture(scope="session")
def networks(tmp_path_factory: pytest.TempPathFactory) -> Export:
    """A model with the paper's networks in the place of grids, its weights random.

    One hidden layer is wide enough for whole numbers.
    """
    folder = tmp_path_factory.mktemp("paper")
    wide = "{kind: gabor, width: 64, layers: 3, input_scale: 8.0, alpha: 3.0}"
    run = random_networks(folder, f"model.static.field={wide}", f"model.dynamic.field={wide}")
    return exported_as(folder / "model.onnx", run, "none")


@pytest.fixture(scope="session")
def quantised(networks: Export, tmp_path_factory: pytest.TempPathFactory) -> Export:
    """The same in whole numbers."""
    return exported_as(tmp_path_factory.mktemp("int8") / "int8.onnx", networks.run, "none", "int8")


def random_networks(folder: Path, *overrides: str) -> Path:
    """A run of the `paper` preset that was never fitted."""
    config = load("paper", overrides=(*TINY_PAPER, *overrides))
    model = randomised(tiny_model("paper", frames=FRAMES, height=HEIGHT, width=WIDTH, overrides=overrides), 0.05)
    checkpoint.save(
        folder / FILE_NAME,
        config,
        ClipFacts.of(sliding_square()),
        model,
        {"step": 1, "budget": {"steps": 9, "seconds": None}},
    )
    return folder


def exported_as(path: Path, run: Path, bake: Bake, precision: Precision = "fp32") -> Export:
    """`run` exported through Python; what differs in precision alone is traced once, which takes most of the time."""
    trace = exporter.trace
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("decomo_export.precision.SMALLEST", 1024)  # of a tiny model nothing is large
        patch.setattr(exporter, "trace", lambda graph: traced(run, bake, lambda: trace(graph)))
        exported = export(path, run, bake=bake, precision=precision, force=precision != "fp32")
    return Export(exported.path, run, "", bake)


def traced(run: Path, bake: Bake, trace: Callable[[], onnx.ModelProto]) -> onnx.ModelProto:
    """What `trace` gave for the run and the baking."""
    if (run, bake) not in TRACES:
        TRACES[run, bake] = trace()
    return TRACES[run, bake]


@pytest.fixture(params=["fitted", "unbaked", "whole", "folded", "networks"])
def exported(request: pytest.FixtureRequest) -> Export:
    """Any of those in full precision."""
    return request.getfixturevalue(request.param)

"""The written file keeps the contract: names, axes, operators, metadata."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
from onnx import TensorProto

import decomo_export
from decomo_export.exporter import unusual_metadata
from decomo_runtime import Tracker, contract
from decomotion import checkpoint
from decomotion.checkpoint import ClipFacts
from decomotion.clip import Clip
from decomotion.quality import Quality
from decomotion.source import code_version
from tiny_export import Export
from tiny_fit import sliding_square
from tiny_model import write_tiny_model

AXES = {
    contract.QUERIES: ("N", 3),
    contract.FRAMES: ("M",),
    contract.TRACKS: ("N", "M", 2),
    contract.OCCLUSION: ("N", "M"),
    contract.RGB: ("N", 3),
    contract.RGB_STATIC: ("N", 3),
    contract.RGB_DYNAMIC: ("N", 3),
    contract.STATIC_CONFIDENCE: ("N",),
    contract.DEPTH: ("N",),
    contract.STATIC_OPACITY: ("N",),
}
TYPES = {contract.FRAMES: TensorProto.INT64}
RUN_BY_1_18 = (
    "Abs Add And Cast CastLike Clip Concat ConstantOfShape Cos CumSum Div Equal Exp Expand Flatten Floor Gather Gemm "
    "Greater GreaterOrEqual Identity If LeakyRelu Less MatMul Max Min Mul Neg NonZero Not Or Range Reciprocal "
    "ReduceL2 ReduceMax ReduceSum Relu Reshape ScatterElements Shape Sigmoid Sin Slice Softplus Split Sqrt "
    "Squeeze Sub Tanh Transpose Unsqueeze Where"
)
"""Operators of files that onnxruntime 1.18.0 answered as 1.31 does: `cpu` baked by depth, `paper` unbaked."""


def test_the_checker_is_content(exported: Export):
    onnx.checker.check_model(str(exported.path), full_check=True)


def test_inputs_and_outputs_have_the_contract_s_names_types_and_axes(exported: Export):
    graph = exported.proto().graph
    assert tuple(value.name for value in graph.input) == contract.INPUTS
    assert tuple(value.name for value in graph.output) == contract.OUTPUTS
    for value in (*graph.input, *graph.output):
        tensor = value.type.tensor_type
        assert tuple(dim.dim_param or dim.dim_value for dim in tensor.shape.dim) == AXES[value.name]
        assert tensor.elem_type == TYPES.get(value.name, TensorProto.FLOAT)


def nodes(graph: onnx.GraphProto) -> Iterator[onnx.NodeProto]:
    """All nodes, those in branches too."""
    for node in graph.node:
        yield node
        for attribute in node.attribute:
            if attribute.type == onnx.AttributeProto.GRAPH:
                yield from nodes(attribute.g)


def test_standard_operators_alone(exported: Export):
    proto = exported.proto()
    assert [opset.domain for opset in proto.opset_import] == [""]
    assert {node.domain for node in nodes(proto.graph)} == {""}
    assert not proto.functions


def test_the_oldest_onnxruntime_that_we_declare_runs_it(exported: Export):
    """By its tables, https://onnxruntime.ai/docs/reference/compatibility.html, and the operators tried in it.

    An operator that is not among them wants a run of an exported file with that version before it joins.
    """
    root = Path(__file__).parents[2]
    declared = tomllib.loads((root / "pyproject.toml").read_text())["project"]["dependencies"]
    assert "onnxruntime>=1.18" in declared
    proto = exported.proto()
    assert proto.opset_import[0].version == contract.OPSET <= 21
    assert proto.ir_version == contract.IR_VERSION <= 10
    assert {node.op_type for node in nodes(proto.graph)} <= set(RUN_BY_1_18.split())


def test_onnxruntime_has_nothing_to_warn_of(exported: Export, capfd: pytest.CaptureFixture[str]):
    onnxruntime.InferenceSession(str(exported.path), providers=["CPUExecutionProvider"])
    assert capfd.readouterr().err == ""


def test_nothing_of_the_machine_that_wrote_it(exported: Export):
    proto = exported.proto()
    assert str(Path(decomo_export.__file__).parents[1]).encode() not in proto.SerializeToString()
    assert not any(node.metadata_props or node.doc_string for node in nodes(proto.graph))


def test_one_file(exported: Export):
    """No weights beside it."""
    assert all(tensor.data_location == TensorProto.DEFAULT for tensor in exported.proto().graph.initializer)


@pytest.mark.parametrize(("name", "preset"), [("fitted", "cpu"), ("networks", "paper")])
def test_metadata(name: str, preset: str, request: pytest.FixtureRequest):
    exported: Export = request.getfixturevalue(name)
    written = {entry.key: entry.value for entry in exported.proto().metadata_props}
    of_track, rendered = (
        int(written.pop(key)) for key in (contract.META_BYTES_PER_RAY, contract.META_BYTES_PER_RENDERED_RAY)
    )
    samples = exported.graph.model.config.samples
    assert rendered == of_track * (1 if exported.bake == "none" else samples) >= 4 * samples
    assert written == {
        contract.META_FORMAT_VERSION: str(contract.FORMAT_VERSION),
        contract.META_CLIP_NAME: "sliding",
        contract.META_NUM_FRAMES: "8",
        contract.META_HEIGHT: "28",
        contract.META_WIDTH: "40",
        contract.META_FPS: "24.0",
        contract.META_PRESET: preset,
        contract.META_OCCLUSION_THRESHOLD: "0.5",
        contract.META_OBJECT_SHARE: "0.1",
        contract.META_WRITER_VERSION: code_version(),
        contract.META_FITTED_BY: checkpoint.load(exported.run / checkpoint.FILE_NAME).code,
        contract.META_STEPS: "20" if name == "fitted" else "1",
        contract.META_BUDGET: json.dumps({"steps": 20 if name == "fitted" else 9, "seconds": None}),
        contract.META_BAKE: exported.bake,
        contract.META_PRECISION: "fp32",
        contract.META_DEVIATION: "0 0",
        **({contract.META_QUALITY: kept.as_json()} if (kept := quality_of(exported)) else {}),
    }
    assert Tracker(exported.path, threads=1).quality == kept
    assert (kept is not None) == (name == "fitted")  # the other was never fitted


def quality_of(exported: Export) -> Quality | None:
    return checkpoint.load(exported.run / checkpoint.FILE_NAME).quality


def test_metadata_of_an_unusual_clip(tmp_path: Path):
    times = np.array([0, 1 / 30, 0.066667, 0.1, 0.2, 0.3, 0.4, 0.5])
    frames = sliding_square().frames
    metadata = unusual_metadata(ClipFacts.of(Clip("phone", frames, times=times, pixel_aspect=16 / 11)))
    assert unusual_metadata(ClipFacts.of(Clip("plain", frames, 24.0))) == {}
    size = {"num_frames": 8, "height": 28, "width": 40}
    tracker = Tracker(write_tiny_model(tmp_path / "model.onnx", **size, metadata=metadata))
    np.testing.assert_allclose(tracker.times, times, atol=1e-6)
    assert tracker.pixel_aspect == 16 / 11

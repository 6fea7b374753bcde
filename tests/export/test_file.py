"""The written file keeps the contract: names, axes, operators, metadata."""

from __future__ import annotations

import onnx
import pytest
from onnx import TensorProto

import decomotion
from decomo_runtime import contract
from tiny_export import Export

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
    contract.APPEARANCE: (),
}
TYPES = {contract.FRAMES: TensorProto.INT64, contract.APPEARANCE: TensorProto.BOOL}


def test_the_checker_is_content(exported: Export):
    onnx.checker.check_model(str(exported.path), full_check=True)


def test_inputs_and_outputs_have_the_contract_s_names_types_and_axes(exported: Export):
    graph = exported.proto().graph
    assert tuple(value.name for value in graph.input) == (*contract.INPUTS, contract.APPEARANCE)
    assert tuple(value.name for value in graph.output) == contract.OUTPUTS
    for value in (*graph.input, *graph.output):
        tensor = value.type.tensor_type
        assert tuple(dim.dim_param or dim.dim_value for dim in tensor.shape.dim) == AXES[value.name]
        assert tensor.elem_type == TYPES.get(value.name, TensorProto.FLOAT)


def test_standard_operators_alone(exported: Export):
    proto = exported.proto()
    assert [opset.domain for opset in proto.opset_import] == [""]
    assert proto.opset_import[0].version >= 18
    assert {node.domain for node in proto.graph.node} == {""}
    assert not proto.functions


def test_one_file(exported: Export):
    """No weights beside it."""
    assert all(tensor.data_location == TensorProto.DEFAULT for tensor in exported.proto().graph.initializer)


@pytest.mark.parametrize(("name", "preset"), [("fitted", "cpu"), ("networks", "paper")])
def test_metadata(name: str, preset: str, request: pytest.FixtureRequest):
    exported: Export = request.getfixturevalue(name)
    written = {entry.key: entry.value for entry in exported.proto().metadata_props}
    assert int(written.pop(contract.META_BYTES_PER_RAY)) > 0
    assert written == {
        contract.META_FORMAT_VERSION: str(contract.FORMAT_VERSION),
        contract.META_CLIP_NAME: "sliding",
        contract.META_NUM_FRAMES: "8",
        contract.META_HEIGHT: "32",
        contract.META_WIDTH: "32",
        contract.META_FPS: "24.0",
        contract.META_PRESET: preset,
        contract.META_OCCLUSION_THRESHOLD: "0.5",
        contract.META_WRITER_VERSION: decomotion.__version__,
        contract.META_BAKE: exported.bake,
        contract.META_PRECISION: "fp32",
        contract.META_DEVIATION: "0 0",
    }

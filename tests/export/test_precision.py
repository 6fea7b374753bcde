"""Weights of less precision: smaller files, deviations stated, refused where they are too large."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import onnxruntime as ort
import pytest
from onnx import TensorProto

from decomo_export import export, exporter
from decomo_export.errors import ExportError
from decomo_export.precision import Deviation, deviation, reduce_precision
from decomo_runtime import Tracker, contract
from tiny_export import Export, random_queries


def test_float16_weights_of_a_fully_baked_model(canonical: Export):
    proto = canonical.proto()
    assert any(tensor.data_type == TensorProto.FLOAT16 for tensor in proto.graph.initializer)
    facts = {entry.key: entry.value for entry in proto.metadata_props}
    assert facts[contract.META_PRECISION] == "fp16"
    assert facts[contract.META_BAKE] == "full"
    mean, p99 = (float(word) for word in facts[contract.META_DEVIATION].split())
    assert 0 < mean <= p99 < 0.5
    queries = random_queries(30)
    expected, *_ = canonical.ask_torch(queries, np.arange(8))
    given, *_ = canonical.ask_file(queries, np.arange(8))
    distance = np.linalg.norm(given - expected, axis=-1)
    assert distance.mean() < 0.1
    assert np.isfinite(Tracker(canonical.path).track([(0, 3, 4)]).xy).all()


def test_a_large_deviation_is_refused_but_not_by_force(fitted: Export, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(exporter, "_trace", lambda graph: fitted.proto())
    monkeypatch.setattr(exporter, "_on_demand", lambda whole: whole)
    monkeypatch.setattr(exporter, "deviation", lambda *_: Deviation(0.3, 0.75))
    with pytest.raises(
        ExportError, match=r"0\.3 px in the mean and 0\.75 px at the 99th .*nothing was written; .*--force"
    ):
        export(tmp_path / "model.onnx", fitted.run, precision="fp16")
    assert not list(tmp_path.iterdir())
    forced = export(tmp_path / "model.onnx", fitted.run, precision="fp16", force=True)
    facts = {entry.key: entry.value for entry in onnx.load(forced.path).metadata_props}
    assert [float(word) for word in facts[contract.META_DEVIATION].split()] == [0.3, 0.75]


def test_int8_needs_wide_layers(networks: Export):
    with pytest.raises(ExportError, match="int8 would change nothing: it is for layers of 64 inputs or more"):
        reduce_precision(networks.proto(), "int8")


def test_int8_quantises_a_wide_layer():
    weights = np.random.default_rng(0).normal(size=(64, 8)).astype(np.float32)
    graph = onnx.helper.make_graph(
        [onnx.helper.make_node("MatMul", ["x", "w"], ["y"])],
        "wide",
        [onnx.helper.make_tensor_value_info("x", TensorProto.FLOAT, ["N", 64])],
        [onnx.helper.make_tensor_value_info("y", TensorProto.FLOAT, ["N", 8])],
        [onnx.numpy_helper.from_array(weights, "w")],
    )
    proto = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 18)], ir_version=9)
    reduced = reduce_precision(proto, "int8")
    assert "MatMulInteger" in {node.op_type for node in reduced.graph.node}
    assert {node.domain for node in reduced.graph.node} == {""}
    assert [opset.domain for opset in reduced.opset_import] == [""]
    x = np.random.default_rng(1).normal(size=(5, 64)).astype(np.float32)
    given = ort.InferenceSession(reduced.SerializeToString()).run(["y"], {"x": x})[0]
    # each weight and each input is rounded to 1 of 255 steps, 64 such errors are added
    np.testing.assert_allclose(given, x @ weights, atol=0.3)
    assert np.abs(x @ weights).mean() > 5


def test_deviation_of_a_graph_from_itself(fitted: Export):
    proto = fitted.proto()
    assert deviation(proto, proto, 8, 32, 32) == Deviation(0.0, 0.0)

"""Weights of less precision: smaller files, deviations stated, refused where they are too large."""

from __future__ import annotations

import logging
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import onnx
import onnxruntime as ort
import pytest
from onnx import TensorProto

from decomo_export import export, exporter, precision
from decomo_export.errors import ExportError
from decomo_export.parity import open_session
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


def test_float16_is_for_constants_from_4_kib_on_but_not_for_what_positions_are_proportional_to():
    """A position needs more than eleven bits."""
    floats = {"bias": 1023, "weight": 1024, "static.to_first": 1024, "static.from_first": 1024, "lowest": 1024}
    arrays = {name: np.linspace(0, 1, count, dtype=np.float32) for name, count in floats.items()}
    arrays["step"] = np.ones(1024, np.float32)
    whole_numbers = onnx.numpy_helper.from_array(np.arange(2048), "codes")
    graph = onnx.helper.make_graph(
        [
            onnx.helper.make_node("Concat", ["x", *arrays], ["y"], axis=0),
            onnx.helper.make_node("Identity", ["codes"], ["z"]),
        ],
        "constants",
        [onnx.helper.make_tensor_value_info("x", TensorProto.FLOAT, ["N"])],
        [
            onnx.helper.make_tensor_value_info("y", TensorProto.FLOAT, ["M"]),
            onnx.helper.make_tensor_value_info("z", TensorProto.INT64, [2048]),
        ],
        [*(onnx.numpy_helper.from_array(array, name) for name, array in arrays.items()), whole_numbers],
    )
    proto = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 18)], ir_version=9)
    reduced = reduce_precision(proto, "fp16")
    stored = {tensor.name: tensor.data_type for tensor in reduced.graph.initializer}
    assert [name for name, kind in stored.items() if kind == TensorProto.FLOAT16] == ["weight_fp16"]
    assert stored["codes"] == TensorProto.INT64
    given = ort.InferenceSession(reduced.SerializeToString()).run(["y"], {"x": np.zeros(2, np.float32)})[0]
    arrays["weight"] = arrays["weight"].astype(np.float16).astype(np.float32)
    np.testing.assert_array_equal(given, np.concatenate([np.zeros(2, np.float32), *arrays.values()]))


def test_a_large_deviation_is_refused_but_not_by_force(fitted: Export, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(exporter, "trace", lambda graph: fitted.proto())
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


def test_int8_needs_wide_layers(fitted: Export):
    with pytest.raises(ExportError, match="int8 would change nothing: it is for layers of 64 inputs and outputs"):
        reduce_precision(fitted.proto(), "int8")


def test_int8_quantises_wide_layers_of_either_form():
    """A MatMul, and a matrix that two Gemm share, as PyTorch's layers have it: rows are outputs."""
    random = np.random.default_rng(0)
    shapes = {"w": (64, 64), "v": (64, 64), "bias": (64,), "narrow": (8, 64)}
    arrays = {name: random.normal(size=shape).astype(np.float32) / 8 for name, shape in shapes.items()}
    make = onnx.helper.make_node
    graph = onnx.helper.make_graph(
        [
            make("MatMul", ["x", "w"], ["first"]),
            make("Gemm", ["first", "v", "bias"], ["second"], transB=1),
            make("Gemm", ["second", "v", "bias"], ["third"], transB=1),
            make("Gemm", ["third", "narrow"], ["y"], transB=1),
        ],
        "wide",
        [onnx.helper.make_tensor_value_info("x", TensorProto.FLOAT, ["N", 64])],
        [onnx.helper.make_tensor_value_info("y", TensorProto.FLOAT, ["N", 8])],
        [onnx.numpy_helper.from_array(array, name) for name, array in arrays.items()],
    )
    proto = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 18)], ir_version=9)
    reduced = reduce_precision(proto, "int8")
    kinds = [node.op_type for node in reduced.graph.node]
    assert (kinds.count("MatMulInteger"), kinds.count("MatMul"), kinds.count("Gemm")) == (3, 1, 0)
    assert {node.domain for node in reduced.graph.node} == {""}
    assert [opset.domain for opset in reduced.opset_import] == [""]
    x = np.random.default_rng(1).normal(size=(5, 64)).astype(np.float32)
    given = ort.InferenceSession(reduced.SerializeToString()).run(["y"], {"x": x})[0]
    hidden = x @ arrays["w"]
    for _ in range(2):
        hidden = hidden @ arrays["v"].T + arrays["bias"]
    # each weight is rounded to 1 of 128 steps, each input to 1 of 255; 64 such errors are added, three times
    np.testing.assert_allclose(given, hidden @ arrays["narrow"].T, atol=0.15)
    assert np.abs(hidden @ arrays["narrow"].T).mean() > 0.5


def as_avx2_multiplies(inputs: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """uint8 [N, K] by int8 [K, M] as x86 without VNNI does it: pairs of products are added in 16 bits, which saturate.

    (vpmaddubsw, then vpmaddwd and vpaddd in 32 bits.)
    """
    products = inputs.astype(np.int64)[:, :, None] * weights.astype(np.int64)
    pairs = (products[:, 0::2] + products[:, 1::2]).clip(-(2**15), 2**15 - 1)
    return pairs.sum(axis=1)


def test_int8_says_nothing_and_leaves_the_log_s_level_alone(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
):
    levels, root = [], logging.getLogger()
    monkeypatch.setattr(root, "setLevel", levels.append)
    reduce_precision(wide_product(np.ones((64, 96), np.float32)), "int8")
    assert not levels
    assert not caplog.records


def wide_product(matrix: np.ndarray) -> onnx.ModelProto:
    """A graph that multiplies by `matrix`."""
    rows, columns = matrix.shape
    graph = onnx.helper.make_graph(
        [onnx.helper.make_node("MatMul", ["x", "w"], ["y"])],
        "wide",
        [onnx.helper.make_tensor_value_info("x", TensorProto.FLOAT, ["N", rows])],
        [onnx.helper.make_tensor_value_info("y", TensorProto.FLOAT, ["N", columns])],
        [onnx.numpy_helper.from_array(matrix, "w")],
    )
    return onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 18)], ir_version=9)


def test_int8_is_the_same_where_pairs_of_products_are_added_in_16_bits():
    """The largest inputs there are, and weights that reach the ends of their range, two and two."""
    random = np.random.default_rng(0)
    matrix = random.normal(size=(64, 96)).astype(np.float32)
    matrix[:8] = np.sign(matrix[:8]) * 5
    proto = wide_product(matrix)
    stored = [onnx.numpy_helper.to_array(each) for each in reduce_precision(proto, "int8").graph.initializer]
    (weights,) = [array for array in stored if array.dtype == np.int8 and array.shape == (64, 96)]
    inputs = np.concatenate([np.full((1, 64), 255, np.uint8), random.integers(200, 256, (20, 64), dtype=np.uint8)])
    assert np.abs(weights.astype(int)).max() == 64  # the whole range is used
    exact = inputs.astype(np.int64) @ weights.astype(np.int64)
    np.testing.assert_array_equal(as_avx2_multiplies(inputs, weights), exact)


def test_deviation_of_a_graph_from_itself(fitted: Export):
    proto = fitted.proto()
    assert deviation(proto, proto, 8, 40, 28, 2048) == Deviation(0.0, 0.0)


def test_deviation_is_measured_in_bounded_memory(fitted: Export, canonical: Export, monkeypatch: pytest.MonkeyPatch):
    both = fitted.proto(), canonical.proto()
    whole, asked, queries = deviation(*both, 8, 40, 28, 2048), [], []

    def opened(proto: onnx.ModelProto) -> SimpleNamespace:
        session = open_session(proto)

        def run(names: list[str], feed: dict[str, np.ndarray]) -> object:
            asked.append(len(feed[contract.FRAMES]))
            queries.append(feed[contract.QUERIES])
            return session.run(names, feed)

        return SimpleNamespace(run=run)

    monkeypatch.setattr(precision, "open_session", opened)
    parts = deviation(*both, 8, 40, 28, 349_525)  # three times 256 of these are 256 MiB
    assert asked == [3, 3, 2] * 2
    assert (parts.mean, parts.p99) == pytest.approx((whole.mean, whole.p99), rel=1e-3)
    assert all(np.array_equal(each, queries[0]) for each in queries)  # the same of both graphs
    t, x, y = queries[0].T
    assert sorted(set(t)) == list(range(8))
    for place, side in ((x, 40), (y, 28)):  # 256 of them reach all borders
        assert -0.5 <= place.min() < 0.5
        assert side - 1.5 < place.max() <= side - 0.5

"""Smaller weights: float16 or int8 in the file, and how far the answers then lie from float32's."""

from __future__ import annotations

import logging
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from decomo_export.errors import ExportError
from decomo_export.parity import open_session
from decomo_runtime import contract

Precision = Literal["fp32", "fp16", "int8"]
LIMIT_PIXELS = 0.5
"""99th percentile of the deviation from which on a file is refused."""
FEWEST_INPUTS = 64
"""Layers with fewer inputs are not worth quantising: converting costs more than multiplying."""
QUERIES = 256
SMALLEST = 4096
"""Bytes; smaller constants, all affine maps of short clips among them, stay as they are."""
POSITIONS = ("to_first", "from_first", "lowest", "step")
"""Constants that positions are proportional to: a float16 has eleven bits, a position needs more."""


@dataclass(frozen=True)
class Deviation:
    """Distance in pixels between the tracks of a file and of the same graph in float32."""

    mean: float
    p99: float


def reduce_precision(proto: onnx.ModelProto, precision: Precision) -> onnx.ModelProto:
    """`proto` with its weights in `precision`; it must not yet have branches.

    fp16: large constants are stored as float16 and cast to float32, which a runtime does once, when it loads.
    int8: products with constant matrices of at least `FEWEST_INPUTS` rows are quantised, dynamically.
    """
    if precision == "fp16":
        return _in_float16(proto)
    return _in_int8(proto) if precision == "int8" else proto


def _in_float16(proto: onnx.ModelProto) -> onnx.ModelProto:
    reduced = onnx.ModelProto()
    reduced.CopyFrom(proto)
    casts = []
    for tensor in reduced.graph.initializer:
        keeps = tensor.name.rsplit(".", 1)[-1].startswith(POSITIONS)
        if tensor.data_type != TensorProto.FLOAT or keeps or _bytes(tensor) < SMALLEST:
            continue
        half = numpy_helper.from_array(numpy_helper.to_array(tensor).astype(np.float16), f"{tensor.name}_fp16")
        casts.append(helper.make_node("Cast", [half.name], [tensor.name], to=TensorProto.FLOAT))
        tensor.CopyFrom(half)
    body = list(reduced.graph.node)
    del reduced.graph.node[:]
    reduced.graph.node.extend([*casts, *body])
    return reduced


def _bytes(tensor: onnx.TensorProto) -> int:
    return 4 * int(np.prod(tensor.dims))


def _in_int8(proto: onnx.ModelProto) -> onnx.ModelProto:
    from onnxruntime.quantization import QuantType, quantize_dynamic

    inputs = {tensor.name: tensor.dims[0] for tensor in proto.graph.initializer if len(tensor.dims) == 2}
    products = [node for node in proto.graph.node if node.op_type in ("MatMul", "Gemm") and node.input[1] in inputs]
    wide = [node for node in products if inputs[node.input[1]] >= FEWEST_INPUTS]
    if not wide:
        raise ExportError(
            f"int8 would change nothing: it is for layers of {FEWEST_INPUTS} inputs or more, which this model does not "
            "have; export with --precision fp16, or fp32"
        )
    for index, node in enumerate(proto.graph.node):
        node.name = f"node_{index}"
    level = logging.getLogger().level
    logging.getLogger().setLevel(logging.ERROR)  # it recommends a preprocessing that would add nothing
    try:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "quantised.onnx"
            names = [node.name for node in wide]
            quantize_dynamic(proto, path, nodes_to_quantize=names, weight_type=QuantType.QInt8, per_channel=True)
            reduced = onnx.load(path)
    finally:
        logging.getLogger().setLevel(level)
    kept = [opset for opset in reduced.opset_import if opset.domain == ""]
    del reduced.opset_import[:]
    reduced.opset_import.extend(kept)
    return reduced


def deviation(
    proto: onnx.ModelProto, reference: onnx.ModelProto, num_frames: int, width: int, height: int
) -> Deviation:
    """How far the tracks of `proto` are from those of `reference`: `QUERIES` random queries in all frames."""
    random = np.random.default_rng(0)
    place = random.uniform(-0.5, [width - 0.5, height - 0.5], (QUERIES, 2))
    asked = {
        contract.QUERIES: np.column_stack([random.integers(num_frames, size=QUERIES), place]).astype(np.float32),
        contract.FRAMES: np.arange(num_frames),
    }
    tracks = [np.asarray(open_session(each).run([contract.TRACKS], asked)[0]) for each in (proto, reference)]
    distance = np.linalg.norm(tracks[0] - tracks[1], axis=-1)
    return Deviation(float(distance.mean()), float(np.quantile(distance, 0.99)))

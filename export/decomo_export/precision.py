"""Smaller weights: float16 or int8 in the file, and how far the answers then lie from float32's."""

from __future__ import annotations

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
from decomotion.chance import generator

Precision = Literal["fp32", "fp16", "int8"]
LIMIT_PIXELS = 0.5
"""99th percentile of the deviation from which on a file is refused."""
NARROWEST = 64
"""Layers with fewer inputs or outputs are not worth quantising: converting costs more than multiplying."""
QUERIES = 256
MEMORY = 2**28
"""Bytes that a measurement of the deviation may work with, roughly."""
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
    int8: products with constant matrices of at least `NARROWEST` rows and columns are quantised, dynamically. Weights
    have seven bits, from -64 to 64: processors with AVX2 and no VNNI add two products with 8-bit inputs in 16 bits,
    where more would be cut off (255 * 64 * 2 < 2^15).
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

    products = _without_gemm(proto)
    for index, node in enumerate(products.graph.node):
        node.name = f"node_{index}"
    sides = {tensor.name: tensor.dims for tensor in products.graph.initializer if len(tensor.dims) == 2}
    wide = [
        node.name
        for node in products.graph.node
        if node.op_type == "MatMul" and node.input[1] in sides and min(sides[node.input[1]]) >= NARROWEST
    ]
    if not wide:
        raise ExportError(
            f"int8 would change nothing: it is for layers of {NARROWEST} inputs and outputs or more, which this model "
            "does not have; export with --precision fp16, or fp32"
        )
    helper.set_model_props(products, {"onnx.quant.pre_process": "onnxruntime.quant"})  # else it recommends that
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "quantised.onnx"
        quantize_dynamic(
            products, path, nodes_to_quantize=wide, weight_type=QuantType.QInt8, per_channel=True, reduce_range=True
        )
        reduced = onnx.load(path)
    kept = [opset for opset in reduced.opset_import if opset.domain == ""]
    del reduced.opset_import[:]
    reduced.opset_import.extend(kept)
    return reduced


def _without_gemm(proto: onnx.ModelProto) -> onnx.ModelProto:
    """A copy in which each Gemm with a constant matrix is a MatMul and an Add.

    `quantize_dynamic` begins with the same, but loses the nodes' names and takes it that no matrix has two users.
    """
    model = onnx.ModelProto()
    model.CopyFrom(proto)
    graph, nodes = model.graph, []
    weights = {tensor.name: tensor for tensor in graph.initializer}
    for node in graph.node:
        settings = {"alpha": 1.0, "beta": 1.0, "transA": 0, "transB": 0}
        settings |= {each.name: helper.get_attribute_value(each) for each in node.attribute}
        turns = settings.pop("transB")
        if node.op_type != "Gemm" or node.input[1] not in weights or settings != {"alpha": 1, "beta": 1, "transA": 0}:
            nodes.append(node)
            continue
        weight, bias = node.input[1], list(node.input[2:])
        if turns:
            weight = f"{weight}_turned"
            turned = numpy_helper.to_array(weights[node.input[1]]).T
            weights.setdefault(weight, numpy_helper.from_array(np.ascontiguousarray(turned), weight))
        product = f"{node.output[0]}_product" if bias else node.output[0]
        nodes.append(helper.make_node("MatMul", [node.input[0], weight], [product]))
        if bias:
            nodes.append(helper.make_node("Add", [product, *bias], list(node.output)))
    used = {name for node in nodes for name in node.input}
    del graph.node[:], graph.initializer[:]
    graph.node.extend(nodes)
    graph.initializer.extend(tensor for name, tensor in weights.items() if name in used)
    return model


def deviation(
    proto: onnx.ModelProto, reference: onnx.ModelProto, num_frames: int, width: int, height: int, bytes_per_ray: int
) -> Deviation:
    """How far the tracks of `proto` are from those of `reference`: `QUERIES` random queries in all frames.

    So many frames are asked for at once as `MEMORY` has room for, `bytes_per_ray` being that of the graph.
    """
    random = generator(0, "deviation")
    place = random.uniform(-0.5, [width - 0.5, height - 0.5], (QUERIES, 2))
    queries = np.column_stack([random.integers(num_frames, size=QUERIES), place]).astype(np.float32)
    at_once = max(1, MEMORY // (QUERIES * bytes_per_ray))
    parts = np.split(np.arange(num_frames), range(at_once, num_frames, at_once))
    tracks = []
    for session in map(open_session, (proto, reference)):
        asked = ({contract.QUERIES: queries, contract.FRAMES: frames} for frames in parts)
        tracks.append(np.concatenate([np.asarray(session.run([contract.TRACKS], part)[0]) for part in asked], axis=1))
    distance = np.linalg.norm(tracks[0] - tracks[1], axis=-1)
    return Deviation(float(distance.mean()), float(np.quantile(distance, 0.99)))

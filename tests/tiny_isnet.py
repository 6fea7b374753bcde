"""A file in the form of IS-Net's: each pixel of the mask is a weighted sum of its colour, kept in [0, 1]."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto


def write_network(
    file: Path, weights: Sequence[float] = (0, 0, 0), bias: float = 0.0, shape: Sequence[int | str] = (1, 3, 48, 64)
) -> Path:
    """`weights` of red, green and blue, each in [-0.5, 0.5]; `shape` of the image that goes in."""
    make = onnx.helper
    graph = make.make_graph(
        [
            make.make_node("Conv", ["image", "weights", "bias"], ["sum"]),
            make.make_node("Clip", ["sum", "least", "most"], ["mask"]),
        ],
        "tiny",
        [make.make_tensor_value_info("image", TensorProto.FLOAT, shape)],
        [make.make_tensor_value_info("mask", TensorProto.FLOAT, [shape[0], 1, *shape[2:]])],
        [
            onnx.numpy_helper.from_array(np.array(values, np.float32).reshape(sides), name)
            for name, values, sides in (
                ("weights", weights, (1, 3, 1, 1)),
                ("bias", [bias], (1,)),
                ("least", 0, ()),
                ("most", 1, ()),
            )
        ],
    )
    onnx.save(make.make_model(graph, opset_imports=[make.make_opsetid("", 18)], ir_version=9), str(file))
    return file

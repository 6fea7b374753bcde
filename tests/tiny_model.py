"""A model file without a fit: every point moves with one constant velocity. It keeps the whole ONNX contract."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from decomo_runtime import contract

VELOCITY = (1.5, -0.5)
"""Pixels a frame, (x, y)."""


def write_tiny_model(path: Path, *, num_frames: int, height: int, width: int, clip_name: str = "tiny") -> Path:
    """Writes a model whose answer is known: xy + (frame - t) * VELOCITY, and an occlusion that grows with |frame - t|.

    The occlusion score is |frame - t| / num_frames; colours and static confidence are 0.5, the depth is 1.
    """
    constants = {
        "velocity": np.array(VELOCITY, np.float32),
        "num_frames": np.float32(num_frames),
        "from_t": np.array([0]),
        "to_t": np.array([1]),
        "to_y": np.array([3]),
        "last": np.array([-1]),
        "middle": np.array([1]),
        "per_query": np.array([[0.0, 0.0, 0.0]], np.float32),
        "half": np.float32(0.5),
    }
    nodes = [
        helper.make_node("Slice", ["queries", "from_t", "to_t", "middle"], ["t"]),
        helper.make_node("Slice", ["queries", "to_t", "to_y", "middle"], ["xy"]),
        helper.make_node("Cast", ["frames"], ["frame"], to=TensorProto.FLOAT),
        helper.make_node("Sub", ["frame", "t"], ["elapsed"]),
        helper.make_node("Unsqueeze", ["elapsed", "last"], ["elapsed_xy"]),
        helper.make_node("Mul", ["elapsed_xy", "velocity"], ["displacement"]),
        helper.make_node("Unsqueeze", ["xy", "middle"], ["start"]),
        helper.make_node("Add", ["start", "displacement"], [contract.TRACKS]),
        helper.make_node("Abs", ["elapsed"], ["distance"]),
        helper.make_node("Div", ["distance", "num_frames"], [contract.OCCLUSION]),
        helper.make_node("Mul", ["queries", "per_query"], ["zero"]),
        *(
            helper.make_node("Add", ["zero", "half"], [name])
            for name in (contract.RGB, contract.RGB_STATIC, contract.RGB_DYNAMIC)
        ),
        helper.make_node("ReduceMean", [contract.RGB, "last"], [contract.STATIC_CONFIDENCE], keepdims=0),
        helper.make_node("Add", [contract.STATIC_CONFIDENCE, "half"], [contract.DEPTH]),
    ]
    shapes = {
        contract.TRACKS: ["N", "M", 2],
        contract.OCCLUSION: ["N", "M"],
        contract.RGB: ["N", 3],
        contract.RGB_STATIC: ["N", 3],
        contract.RGB_DYNAMIC: ["N", 3],
        contract.STATIC_CONFIDENCE: ["N"],
        contract.DEPTH: ["N"],
    }
    graph = helper.make_graph(
        nodes,
        "constant_velocity",
        [
            helper.make_tensor_value_info(contract.QUERIES, TensorProto.FLOAT, ["N", 3]),
            helper.make_tensor_value_info(contract.FRAMES, TensorProto.INT64, ["M"]),
        ],
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, shapes[name]) for name in contract.OUTPUTS],
        [numpy_helper.from_array(np.asarray(value), name) for name, value in constants.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", contract.OPSET)], ir_version=9)
    helper.set_model_props(
        model,
        {
            contract.META_FORMAT_VERSION: str(contract.FORMAT_VERSION),
            contract.META_CLIP_NAME: clip_name,
            contract.META_NUM_FRAMES: str(num_frames),
            contract.META_HEIGHT: str(height),
            contract.META_WIDTH: str(width),
            contract.META_FPS: "24.0",
            contract.META_PRESET: "cpu",
            contract.META_OCCLUSION_THRESHOLD: "0.5",
            contract.META_WRITER_VERSION: "0",
        },
    )
    onnx.checker.check_model(model, full_check=True)
    path.parent.mkdir(parents=True, exist_ok=True)
    onnx.save(model, path)
    return path

"""Makes a graph answer no queries and no frames.

onnxruntime's reductions and products mislay the axes of empty arrays. The graph's body therefore never sees one: an
empty input is padded to one row, and what the body answers is cut back to the rows that were asked for.
"""

from __future__ import annotations

import numpy as np
import onnx
from onnx import helper, numpy_helper

from decomo_runtime import contract

PADDING = {contract.QUERIES: np.zeros((1, 3), np.float32), contract.FRAMES: np.zeros(1, np.int64)}


def admit_empty(proto: onnx.ModelProto) -> None:
    """Wraps the body of `proto` in place; names, types and axes of inputs and outputs stay as they are."""
    graph = proto.graph
    body = list(graph.node)
    renamed = {name: f"{name}_padded" for name in contract.INPUTS} | {name: f"{name}_all" for name in contract.OUTPUTS}
    for node in body:
        for names in (node.input, node.output):
            names[:] = [renamed.get(name, name) for name in names]

    constants = {"wrap_zero": np.zeros(1, np.int64), "wrap_one": np.ones(1, np.int64)}
    before: list[onnx.NodeProto] = []
    for name, padding in PADDING.items():
        constants[f"{name}_padding"] = padding
        before += [
            helper.make_node("Shape", [name], [f"{name}_count"], end=1),
            helper.make_node("Max", [f"{name}_count", "wrap_one"], [f"{name}_rows"]),
            helper.make_node("Concat", [name, f"{name}_padding"], [f"{name}_longer"], axis=0),
            helper.make_node("Slice", [f"{name}_longer", "wrap_zero", f"{name}_rows"], [f"{name}_padded"]),
        ]
    after: list[onnx.NodeProto] = []
    for name in contract.OUTPUTS:
        cut = name
        if name in (contract.TRACKS, contract.OCCLUSION):
            cut = f"{name}_of_queries"
            count = f"{contract.FRAMES}_count"
            after.append(helper.make_node("Slice", [cut, "wrap_zero", count, "wrap_one"], [name]))
        count = f"{contract.QUERIES}_count"
        after.insert(0, helper.make_node("Slice", [f"{name}_all", "wrap_zero", count], [cut]))

    del graph.node[:]
    graph.node.extend([*before, *body, *after])
    graph.initializer.extend(numpy_helper.from_array(value, name) for name, value in constants.items())
    del graph.value_info[:]  # shapes recorded for the unpadded body no longer hold

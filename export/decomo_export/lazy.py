"""Makes a graph compute what is asked for and no more.

onnxruntime runs all nodes of a graph, whichever outputs are fetched. What only tracks and occlusion need therefore goes
into a branch that is taken where there are frames to look in, and what only the appearance of the queries needs into
one that is taken where there are none. The rest of the body never sees an empty array, whose axes some of onnxruntime's
operators mislay: no queries are padded to one, and its answer is cut off.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from decomo_runtime import contract

LAST = {f"{contract.TRACKS}_padded": "lazy_two"} | {
    f"{name}_padded": "lazy_three" for name in (contract.RGB, contract.RGB_STATIC, contract.RGB_DYNAMIC)
}
"""Constants that are the last axis of an output of the body, where that is not of length 1."""
CONSTANTS = {
    "lazy_zero": np.zeros(1, np.int64),
    "lazy_one": np.ones(1, np.int64),
    "lazy_two": np.full(1, 2, np.int64),
    "lazy_three": np.full(1, 3, np.int64),
    "lazy_no_query": np.zeros((1, 3), np.float32),
}


def compute_on_demand(proto: onnx.ModelProto) -> None:
    """Rewrites the body of `proto` in place; inputs and outputs keep their names."""
    graph = proto.graph
    body = list(graph.node)
    renamed = {contract.QUERIES: "queries_padded"} | {name: f"{name}_padded" for name in contract.OUTPUTS}
    for node in body:
        for names in (node.input, node.output):
            names[:] = [renamed.get(name, name) for name in names]

    for_tracks = _needed_by(body, [renamed[name] for name in contract.TRACKING])
    for_appearance = _needed_by(body, [renamed[name] for name in contract.APPEARANCE])
    shared = [node for index, node in enumerate(body) if index in for_tracks & for_appearance]
    tracks = [node for index, node in enumerate(body) if index in for_tracks - for_appearance]
    appearance = [node for index, node in enumerate(body) if index in for_appearance - for_tracks]

    before = [
        helper.make_node("Shape", [contract.QUERIES], ["query_count"], end=1),
        helper.make_node("Shape", [contract.FRAMES], ["frame_count"], end=1),
        helper.make_node("Max", ["query_count", "lazy_one"], ["query_rows"]),
        helper.make_node("Concat", [contract.QUERIES, "lazy_no_query"], ["queries_longer"], axis=0),
        helper.make_node("Slice", ["queries_longer", "lazy_zero", "query_rows"], ["queries_padded"]),
        helper.make_node("Greater", ["frame_count", "lazy_zero"], ["any_frame"]),
        helper.make_node("Not", ["any_frame"], ["no_frame"]),
    ]
    branches = [
        _branch("any_frame", tracks, [renamed[name] for name in contract.TRACKING], ["frame_count"]),
        _branch("no_frame", appearance, [renamed[name] for name in contract.APPEARANCE], []),
    ]
    after = [
        helper.make_node("Slice", [f"{renamed[name]}_or_none", "lazy_zero", "query_count"], [name])
        for name in contract.OUTPUTS
    ]
    del graph.node[:]
    graph.node.extend([*before, *shared, *branches, *after])
    graph.initializer.extend(numpy_helper.from_array(value, name) for name, value in CONSTANTS.items())
    del graph.value_info[:]  # shapes recorded for the unpadded body no longer hold


def _needed_by(body: Sequence[onnx.NodeProto], names: Iterable[str]) -> set[int]:
    """Indices of the nodes that `names` are computed from."""
    wanted, needed = set(names), set()
    for index in reversed(range(len(body))):
        if wanted.intersection(body[index].output):
            needed.add(index)
            wanted.update(body[index].input)
    return needed


def _branch(
    condition: str, nodes: Sequence[onnx.NodeProto], outputs: Sequence[str], axes: Sequence[str]
) -> onnx.NodeProto:
    """`nodes` where `condition` holds; else NaN, [query, *axes], and the axis of `LAST` where there is one.

    The answers are `<name>_or_none`: an output may be among what both branches need, and then has its name outside.
    """
    nothing = numpy_helper.from_array(np.full(1, np.nan, np.float32))
    otherwise = []
    for name in outputs:
        last = [LAST[name]] if name in LAST else []
        otherwise += [
            helper.make_node("Concat", ["query_rows", *axes, *last], [f"{name}_shape"], axis=0),
            helper.make_node("ConstantOfShape", [f"{name}_shape"], [f"{name}_none"], value=nothing),
        ]
    computed = [helper.make_node("Identity", [name], [f"{name}_computed"]) for name in outputs]
    return helper.make_node(
        "If",
        [condition],
        [f"{name}_or_none" for name in outputs],
        then_branch=_graph("then", [*nodes, *computed], [f"{name}_computed" for name in outputs]),
        else_branch=_graph("otherwise", otherwise, [f"{name}_none" for name in outputs]),
    )


def _graph(name: str, nodes: Sequence[onnx.NodeProto], outputs: Sequence[str]) -> onnx.GraphProto:
    values = [helper.make_tensor_value_info(output, TensorProto.FLOAT, None) for output in outputs]
    return helper.make_graph(list(nodes), name, [], values)

"""From the torch module to the body of the ONNX graph.

By torch's older tracer, which runs the module once and notes its operators in C++: the same operators as by
`torch.export`, in a tenth of the time. Weights are the trace's inputs and are attached afterwards, tables at the very
end: the graph is the same for every number of frames, and so is the time.
"""

from __future__ import annotations

import logging
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import onnx
import onnx_ir
import onnx_ir.passes.common
import onnxscript.optimizer
import torch
from torch import Tensor

from decomo_export.graph import QueryGraph
from decomo_runtime import contract


def trace(graph: QueryGraph) -> onnx.ModelProto:
    """The graph's `forward`, for any number of queries and frames."""
    torch.onnx.register_custom_op_symbolic(  # pyright: ignore[reportPrivateImportUsage]
        "aten::expm1", _expm1, contract.OPSET
    )
    queries = torch.tensor([[0.0, 1.0, 2.0], [1.0, 3.0, 4.0], [0.0, 5.0, 6.0]])
    frames = torch.tensor([0, 1, 0, 1, 1])
    with tempfile.TemporaryDirectory() as folder, _quiet(), torch.no_grad():
        path = Path(folder) / "traced.onnx"
        torch.onnx.export(
            graph,
            (queries, frames),
            path,
            dynamo=False,
            export_params=False,
            do_constant_folding=False,
            dynamic_axes={contract.QUERIES: {0: "N"}, contract.FRAMES: {0: "M"}},
            input_names=list(contract.INPUTS),
            output_names=list(contract.OUTPUTS),
            opset_version=contract.OPSET,
        )
        model = onnx_ir.from_proto(onnx.load(path))
    _attach(model, dict(graph.named_parameters()))
    _tidy(model)
    _attach(model, dict(graph.named_buffers()))
    proto = onnx_ir.to_proto(model)
    del proto.graph.value_info[:]  # the traced sizes
    return proto


@contextmanager
def _quiet() -> Iterator[None]:
    """The tracer's notes on its age and on what it cannot see are not the user's concern: `parity.py` looks."""
    log = logging.getLogger("torch.onnx")
    level = log.level
    log.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        log.setLevel(level)


def _expm1(context: Any, x: torch.Value) -> torch.Value:
    """The one operator of ours that the tracer does not know."""
    return context.op("Sub", context.op("Exp", x), context.op("Constant", value_t=torch.tensor(1.0)))


def _attach(model: onnx_ir.Model, weights: dict[str, Tensor]) -> None:
    """Makes constants of the inputs that are named as weights are; their memory is shared."""
    graph = model.graph
    for value in list(graph.inputs):
        if value.name is None or value.name not in weights:
            continue
        graph.inputs.remove(value)
        value.const_value = onnx_ir.tensor(weights[value.name].detach().numpy(), name=value.name)
        graph.register_initializer(value)


def _tidy(model: onnx_ir.Model) -> None:
    """Constants folded, nothing twice, nothing unused.

    What the tracer notes at each node, a third of the file with paths of this machine in it, is dropped, and so are its
    names. Tables are not there yet: a runtime unfolds them when it loads.
    """
    onnxscript.optimizer.fold_constants(model)
    passes = (
        onnx_ir.passes.common.LiftConstantsToInitializersPass(lift_all_constants=True, size_limit=0),
        onnx_ir.passes.common.DeduplicateInitializersPass(),
        onnx_ir.passes.common.CommonSubexpressionEliminationPass(),
        onnx_ir.passes.common.RemoveUnusedNodesPass(),
        onnx_ir.passes.common.ClearMetadataAndDocStringPass(),
    )
    for each in passes:
        each(model)
    named = {output.name for output in model.graph.outputs}
    for number, node in enumerate(model.graph):
        node.name = ""
        for index, output in enumerate(node.outputs):
            if output.name not in named:
                output.name = f"{number}.{index}" if index else f"{number}"

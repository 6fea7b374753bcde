"""Does the file say what torch says? Measured at sizes other than the traced ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import onnx
import onnxruntime
import torch

from decomo_export.errors import ExportError
from decomo_export.graph import QueryGraph
from decomo_runtime import contract

SIZES = ((1, 1), (37, 4), (128, 9))
"""Queries and frames of the comparisons; the graph is traced at (3, 5)."""
LIMIT_PIXELS = 0.01


@dataclass(frozen=True)
class Parity:
    """Largest differences between torch and onnxruntime on random queries."""

    pixels: float
    """Of the tracks."""
    score: float
    """Of occlusion, colours, confidence and depth; a query on the brink between volumes may differ more."""


def open_session(proto: onnx.ModelProto) -> onnxruntime.InferenceSession:
    """A session on the CPU."""
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3  # errors
    return onnxruntime.InferenceSession(proto.SerializeToString(), options, providers=["CPUExecutionProvider"])


def measure(graph: QueryGraph, proto: onnx.ModelProto) -> Parity:
    """Compares `proto` with `graph`.

    Raises `ExportError` where tracks differ by `LIMIT_PIXELS` or more.
    """
    session = open_session(proto)
    plane, count = graph.model.plane, graph.model.num_frames
    random = np.random.default_rng(0)
    pixels = score = 0.0
    for num_queries, num_frames in SIZES:
        queries = np.stack(
            [
                random.integers(count, size=num_queries),
                random.uniform(-0.5, plane.width - 0.5, num_queries),
                random.uniform(-0.5, plane.height - 0.5, num_queries),
            ],
            axis=-1,
        ).astype(np.float32)
        frames = random.integers(count, size=num_frames)
        with torch.no_grad():
            expected = [value.numpy() for value in graph(torch.from_numpy(queries), torch.from_numpy(frames))]
        asked = {contract.QUERIES: queries, contract.FRAMES: frames}
        given = list(session.run(list(contract.OUTPUTS[:2]), asked))
        given += session.run(list(contract.OUTPUTS[2:]), asked | {contract.FRAMES: frames[:0]})
        differences = [
            float(np.abs(np.asarray(got) - want).max(initial=0.0)) for got, want in zip(given, expected, strict=True)
        ]
        pixels = float(np.maximum(pixels, differences[0]))  # unlike max(), it keeps what is not a number
        score = float(np.max([score, *differences[1:]]))
    if not pixels < LIMIT_PIXELS:
        raise ExportError(
            f"the exported graph differs from torch by {pixels:.3g} px (limit {LIMIT_PIXELS}); nothing was written; "
            "please report this with the versions of torch, onnx and onnxruntime"
        )
    return Parity(pixels, score)

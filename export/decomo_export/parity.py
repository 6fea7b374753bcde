"""Does the file say what torch says? Measured at sizes other than the traced ones."""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import onnx
import onnxruntime
import torch

from decomo_export.errors import ExportError
from decomo_export.graph import QueryGraph
from decomo_runtime import contract
from decomotion.chance import generator
from decomotion.geometry import ImagePlane

log = logging.getLogger(__name__)

SIZES = ((1, 1), (37, 4), (128, 9))
"""Queries and frames of the comparisons; the graph is traced at (3, 5)."""
LIMIT_PIXELS = 0.01
"""Of a frame whose longer side is 256 or less; larger ones have larger positions, which float32 tells apart less."""


@dataclass(frozen=True)
class Parity:
    """Largest differences between torch and onnxruntime on random queries."""

    pixels: float
    """Of the tracks near the image."""
    score: float
    """Of occlusion, colours, confidence and depth; a query on the brink between volumes may differ more."""


def open_session(proto: onnx.ModelProto) -> onnxruntime.InferenceSession:
    """A session on the CPU."""
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3  # errors
    return onnxruntime.InferenceSession(proto.SerializeToString(), options, providers=["CPUExecutionProvider"])


def measure(graph: QueryGraph, proto: onnx.ModelProto, force: bool = False) -> Parity:
    """Compares `proto` with `graph`; tracks, where they lie no farther from the image than it is long.

    Raises `ExportError` where they differ by `LIMIT_PIXELS` or more, or says so in the log with `force`.
    """
    session = open_session(proto)
    plane, count = graph.model.plane, graph.model.num_frames
    random = generator(0, "parity")
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
        tracks = np.asarray(given[0])
        near = ~_far(expected[0], plane) | np.isnan(tracks).any(-1)
        given[0], expected[0] = tracks[near], expected[0][near]
        differences = [
            float(np.abs(np.asarray(got) - want).max(initial=0.0)) for got, want in zip(given, expected, strict=True)
        ]
        pixels = float(np.maximum(pixels, differences[0]))  # unlike max(), it keeps what is not a number
        score = float(np.max([score, *differences[1:]]))
    limit = LIMIT_PIXELS * max(1.0, max(plane.height, plane.width) / 256)
    if not pixels < limit:
        differs = f"the exported graph differs from torch by {pixels:.3g} px (limit {limit:.2g})"
        if not force:
            raise ExportError(
                f"{differs}; nothing was written; please report this with the versions of torch, onnx and onnxruntime, "
                "and export with --force where that is near enough"
            )
        log.warning("%s", differs)
    return Parity(pixels, score)


def _far(xy: npt.NDArray[np.float32], plane: ImagePlane) -> npt.NDArray[np.bool_]:
    """Whether positions [..., 2] lie farther from the image than it is long; not what is not a number."""
    side = max(plane.height, plane.width)
    return np.asarray(((xy < -side) | (xy > np.array([plane.width, plane.height]) + side)).any(-1))

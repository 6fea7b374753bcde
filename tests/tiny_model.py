"""A model file without a fit: points move with one velocity, and each output can be worked out by hand."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import onnx
import onnx.helper
import onnx.parser

from decomo_runtime import contract

VELOCITY = (1.5, -0.5)
"""Pixels a frame, (x, y)."""

GRAPH = """
<ir_version: 9, opset_import: ["" : 18]>
constant_velocity (float[N,3] queries, int64[M] frames) => (
    float[N,M,2] tracks, float[N,M] occlusion, float[N,3] rgb, float[N,3] rgb_static, float[N,3] rgb_dynamic,
    float[N] static_confidence, float[N] depth, float[N] static_opacity)
<float[2] velocity = {1.5, -0.5}, float num_frames = {NUM_FRAMES}, float half = {0.5}, float quarter = {0.25},
 int64[1] first = {0}, int64[1] middle = {1}, int64[1] last = {-1}, int64[1] three = {3}>
{
    t = Slice(queries, first, middle, middle)
    xy = Slice(queries, middle, three, middle)
    frame = Cast<to = 1>(frames)
    elapsed = Sub(frame, t)
    elapsed_xy = Unsqueeze(elapsed, last)
    displacement = Mul(elapsed_xy, velocity)
    start = Unsqueeze(xy, middle)
    tracks = Add(start, displacement)
    distance = Abs(elapsed)
    occlusion = Div(distance, num_frames)
    rgb = Sigmoid(queries)
    rgb_static = Mul(rgb, half)
    rgb_dynamic = Mul(rgb, quarter)
    time = Squeeze(t, last)
    static_confidence = Div(time, num_frames)
    depth = Mul(time, quarter)
    static_opacity = Mul(static_confidence, half)
}
"""


def write_tiny_model(
    path: Path,
    *,
    num_frames: int,
    height: int,
    width: int,
    clip_name: str = "tiny",
    metadata: Mapping[str, str | None] | None = None,
    rename: Mapping[str, str] | None = None,
    opset: int = contract.OPSET,
) -> Path:
    """Writes the model of `GRAPH`, which keeps the whole contract; its occlusion threshold is 0.5.

    To break the contract: `metadata` replaces entries (None: leaves one out), `rename` replaces words of the graph.
    """
    graph = GRAPH.replace("NUM_FRAMES", str(num_frames))
    for old, new in (rename or {}).items():
        graph = graph.replace(old, new)
    model = onnx.parser.parse_model(graph)
    model.opset_import[0].version = opset
    entries: dict[str, str | None] = {
        contract.META_FORMAT_VERSION: str(contract.FORMAT_VERSION),
        contract.META_CLIP_NAME: clip_name,
        contract.META_NUM_FRAMES: str(num_frames),
        contract.META_HEIGHT: str(height),
        contract.META_WIDTH: str(width),
        contract.META_FPS: "12.5",
        contract.META_PRESET: "cpu",
        contract.META_OCCLUSION_THRESHOLD: "0.5",
        contract.META_WRITER_VERSION: "0",
    }
    entries |= metadata or {}
    onnx.helper.set_model_props(model, {key: value for key, value in entries.items() if value is not None})
    path.parent.mkdir(parents=True, exist_ok=True)
    onnx.save(model, path)
    return path

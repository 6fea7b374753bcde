"""A model file without a fit: points move with one velocity, and each output can be worked out by hand."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import cv2
import numpy as np
import onnx
import onnx.helper
import onnx.parser
import pytest

from decomo_runtime import Tracker, contract

NUM_FRAMES, HEIGHT, WIDTH, FPS, THRESHOLD = 6, 40, 48, 12.5, 0.5
VELOCITY = np.array([1.5, -0.5], np.float32)

GRAPH = """
<ir_version: 9, opset_import: ["" : 18]>
constant_velocity (float[N,3] queries, int64[M] frames) => (
    float[N,M,2] tracks, float[N,M] occlusion, float[N,3] rgb, float[N,3] rgb_static, float[N,3] rgb_dynamic,
    float[N] static_confidence, float[N] depth)
<float[2] velocity = {1.5, -0.5}, float num_frames = {6}, float half = {0.5}, float quarter = {0.25},
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
}
"""

METADATA = {
    contract.META_FORMAT_VERSION: str(contract.FORMAT_VERSION),
    contract.META_CLIP_NAME: "slide",
    contract.META_NUM_FRAMES: str(NUM_FRAMES),
    contract.META_HEIGHT: str(HEIGHT),
    contract.META_WIDTH: str(WIDTH),
    contract.META_FPS: str(FPS),
    contract.META_PRESET: "cpu",
    contract.META_OCCLUSION_THRESHOLD: str(THRESHOLD),
    contract.META_WRITER_VERSION: "0",
}


@pytest.fixture
def write_model(tmp_path: Path) -> Callable[..., Path]:
    """Writes `model.onnx`, perhaps with other metadata (None: left out), renamed words or another opset."""

    def write(
        metadata: Mapping[str, str | None] | None = None,
        *,
        rename: Mapping[str, str] | None = None,
        opset: int = contract.OPSET,
    ) -> Path:
        graph = GRAPH
        for old, new in (rename or {}).items():
            graph = graph.replace(old, new)
        model = onnx.parser.parse_model(graph)
        model.opset_import[0].version = opset
        merged = METADATA | dict(metadata or {})
        onnx.helper.set_model_props(model, {key: value for key, value in merged.items() if value is not None})
        path = tmp_path / "model.onnx"
        onnx.save(model, path)
        return path

    return write


@pytest.fixture
def model_path(write_model: Callable[..., Path]) -> Path:
    return write_model()


@pytest.fixture
def tracker(model_path: Path) -> Tracker:
    return Tracker(model_path, threads=1)


@pytest.fixture
def clip_path(tmp_path: Path) -> Path:
    """A folder of frames that fits the model: noise, so that nothing is flat."""
    folder = tmp_path / "slide"
    folder.mkdir()
    for frame in np.random.default_rng(0).integers(0, 256, (NUM_FRAMES, HEIGHT, WIDTH, 3), np.uint8):
        cv2.imwrite(str(folder / f"{len(list(folder.iterdir()))}.png"), frame)
    return folder

"""The tiny model as a file, opened, and a clip that fits it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from decomo_runtime import Tracker
from tiny_model import write_tiny_model

NUM_FRAMES, HEIGHT, WIDTH = 6, 40, 48


@pytest.fixture
def write_model(tmp_path: Path) -> Callable[..., Path]:
    """Writes `model.onnx`, perhaps with other metadata (None: left out), renamed words or another opset."""

    def write(metadata: dict[str, str | None] | None = None, **changes: Any) -> Path:
        size = {"num_frames": NUM_FRAMES, "height": HEIGHT, "width": WIDTH}
        return write_tiny_model(tmp_path / "model.onnx", **size, clip_name="slide", metadata=metadata, **changes)

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

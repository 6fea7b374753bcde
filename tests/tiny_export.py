"""An exported model and the two ways to ask it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt
import onnx
import onnxruntime
import torch

from decomo_export.baking import Bake
from decomo_export.exporter import DEFAULT_BAKE
from decomo_export.graph import QueryGraph
from decomo_runtime import contract
from decomotion import checkpoint
from tiny_fit import FRAMES, HEIGHT, WIDTH


@dataclass(frozen=True)
class Export:
    """A model file, what it was made from and what the command said."""

    path: Path
    run: Path
    said: str
    bake: Bake = DEFAULT_BAKE

    @cached_property
    def graph(self) -> QueryGraph:
        """The same in torch."""
        return QueryGraph(checkpoint.load(self.run / checkpoint.FILE_NAME).model.eval(), self.bake).eval()

    @cached_property
    def session(self) -> onnxruntime.InferenceSession:
        """The opened file."""
        return onnxruntime.InferenceSession(str(self.path), providers=["CPUExecutionProvider"])

    def ask_torch(self, queries: npt.NDArray[np.float32], frames: npt.NDArray[np.int64]) -> list[npt.NDArray]:
        with torch.no_grad():
            return [value.numpy() for value in self.graph(torch.from_numpy(queries), torch.from_numpy(frames))]

    def ask_file(self, queries: npt.NDArray[np.float32], frames: npt.NDArray[np.int64]) -> list[npt.NDArray]:
        """Tracks and occlusion in `frames`, then the appearance."""
        no_frames = {contract.QUERIES: queries, contract.FRAMES: frames[:0]}
        tracks = self.session.run(list(contract.OUTPUTS[:2]), {contract.QUERIES: queries, contract.FRAMES: frames})
        return [np.asarray(answer) for answer in (*tracks, *self.session.run(list(contract.OUTPUTS[2:]), no_frames))]

    def proto(self) -> onnx.ModelProto:
        return onnx.load(self.path)


def random_queries(count: int, seed: int = 0) -> npt.NDArray[np.float32]:
    """Rows of (t, x, y) all over the clip, its outermost half pixels included."""
    random = np.random.default_rng(seed)
    xy = random.uniform(-0.5, [WIDTH - 0.5, HEIGHT - 0.5], (count, 2))
    return np.column_stack([random.integers(FRAMES, size=count), xy]).astype(np.float32)

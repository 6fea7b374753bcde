"""A tracker that knows the sliding square: what a perfect model would answer."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from decomo_runtime import Appearance, ModelFacts, Tracks
from tiny_fit import FRAMES, HEIGHT, SQUARE, SQUARE_START, SQUARE_VELOCITY, WIDTH, on_square, true_target


class TrueTracker:
    """Answers as `decomo_runtime.Tracker` does.

    Args:
        static: what `static_confidence` is off the square.
        height: of the clip, where its lowest rows are cut off.
        object_share: of the model, as in its file's metadata.
    """

    num_frames, width, fps, clip_name = FRAMES, WIDTH, 24.0, "sliding"
    path = Path("sliding.onnx")
    occlusion_threshold, times = 0.5, np.arange(FRAMES) / 24

    def __init__(self, static: float = 1.0, height: int = HEIGHT, object_share: float = 0.1) -> None:
        self.static, self.height = static, height
        self.facts = ModelFacts("sliding", FRAMES, height, WIDTH, 24.0, "cpu", 0.5, object_share)

    def sample(self, queries: npt.ArrayLike) -> Appearance:
        queries = np.asarray(queries, np.float32)
        confidence = np.where(on_square(queries[:, 1:], queries[:, 0]), 0, self.static).astype(np.float32)
        grey = np.full((len(queries), 3), 0.5, np.float32)
        one = np.ones(len(queries), np.float32)
        return Appearance(grey, grey, grey, confidence, one, one)

    def on_object(self, queries: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        return self.sample(queries).static_confidence < 1 - self.facts.object_share

    def track(
        self, queries: npt.ArrayLike, frames: npt.ArrayLike | None = None, *, max_memory: int | None = None
    ) -> Tracks:
        queries = np.asarray(queries, np.float32)
        frames = np.arange(FRAMES) if frames is None else np.asarray(frames)
        start, t = queries[:, None, 1:], queries[:, :1]
        xy = true_target(start, t, frames[None]).astype(np.float32)
        covered = on_square(xy, frames[None]) & ~on_square(start, t)
        occluded = covered | (xy < -0.5).any(-1) | (xy > np.array([WIDTH, self.height]) - 0.5).any(-1)
        return Tracks(xy, occluded, occluded.astype(np.float32), queries, frames)


def square_mask(frame: int) -> npt.NDArray[np.bool_]:
    """[H, W]: where the square is in `frame`."""
    x, y = (SQUARE_START + frame * SQUARE_VELOCITY).astype(int)
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[y : y + SQUARE, x : x + SQUARE] = True
    return mask

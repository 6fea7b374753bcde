"""A tracker that knows a procedural scene and errs by a smooth field, as a fitted model does."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from decomo_eval.sample.scene import Scene
from decomo_runtime import ModelFacts, Tracks


class ErringTracker:
    """Answers as `decomo_runtime.Tracker` does.

    Args:
        scene: what is to be seen; frames show the middle of its square.
        times: [T], of each frame.
        width: of the clip, pixels; so is `height`.
        error: pixels, about the largest by which an answer errs along x or y; 0 in the query's own frame.
    """

    def __init__(self, scene: Scene, times: Sequence[float], width: int, height: int, error: float = 0.0) -> None:
        self.scene, self.times, self.error = scene, times, error
        self.num_frames, self.width, self.height = len(times), width, height
        self.facts = ModelFacts("scene", len(times), height, width, 24.0, "cpu", 0.5, 0.1)

    def track(self, queries: npt.ArrayLike, frames: npt.ArrayLike | None = None) -> Tracks:
        queries = np.asarray(queries, np.float32)
        columns = np.arange(self.num_frames) if frames is None else np.asarray(frames, np.int64)
        xy = np.empty((len(queries), len(columns), 2))
        occluded = np.empty(xy.shape[:2], bool)
        own = self._layer(queries)
        for index, layer in enumerate(self.scene.layers):
            for frame in np.unique(queries[own == index, 0]).astype(int).tolist():
                rows = np.flatnonzero((own == index) & (queries[:, 0] == frame))
                uv = layer.warp(self.times[frame]).to_material(self._fractions(queries[rows, 1:]))
                for column, other in enumerate(columns.tolist()):
                    place = layer.warp(self.times[other]).to_frame(uv)
                    occluded[rows, column] = self.scene.layer_at(place, self.times[other]) != index
                    xy[rows, column] = place * self.width - 0.5 - (0, self._top)
                    xy[rows, column] += self._error(uv, index, other) - self._error(uv, index, frame)
        occluded |= ((xy < -0.5) | (xy >= np.array([self.width, self.height]) - 0.5)).any(-1)
        size = self.height, self.width
        return Tracks(xy.astype(np.float32), occluded, occluded.astype(np.float32), queries, columns, size)

    def on_object(self, queries: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        return self._layer(np.asarray(queries, np.float32)) > 0

    @property
    def _top(self) -> float:
        return (self.width - self.height) / 2

    def _fractions(self, xy: npt.NDArray[np.float32]) -> npt.NDArray[np.float64]:
        return (xy.astype(np.float64) + np.array([0.5, 0.5 + self._top])) / self.width

    def _layer(self, queries: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        places = self._fractions(queries[:, 1:])
        own = np.zeros(len(queries), np.int64)
        for frame in np.unique(queries[:, 0]).astype(int).tolist():
            rows = queries[:, 0] == frame
            own[rows] = self.scene.layer_at(places[rows], self.times[frame])
        return own

    def _error(self, uv: npt.NDArray[np.float64], layer: int, frame: int) -> npt.NDArray[np.float64]:
        turn = self.times[frame] * 5 + layer
        u, v = (uv * (6, 7)).T if layer == 0 else (uv * (1.6, 1.3)).T
        return self.error / 2 * np.stack([np.sin(u + v + turn), np.cos(v - u + 1.3 * turn)], axis=-1)

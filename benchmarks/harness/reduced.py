"""A model of a smaller copy of a clip, asked in pixels of the clip."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from decomo_runtime import Tracker, Tracks


class ReducedTracker:
    """Answers as the `Tracker` of a model that was fitted to the clip itself; the copy may have other proportions.

    Args:
        path: the model's file.
        width: of the clip, pixels; so is `height`.
    """

    def __init__(self, path: Path, width: int, height: int) -> None:
        self._tracker = Tracker(path, threads=1)
        self._scale = np.array([self._tracker.width / width, self._tracker.height / height], np.float32)
        self.facts = replace(self._tracker.facts, width=width, height=height)

    def track(self, queries: npt.ArrayLike, frames: npt.ArrayLike | None = None) -> Tracks:
        """`queries` [N, 3] and tracks are in pixels of the clip."""
        tracks = self._tracker.track(self._reduced(queries), frames)
        xy = ((tracks.xy + 0.5) / self._scale - 0.5).astype(np.float32)
        size = self.facts.height, self.facts.width
        return replace(tracks, xy=xy, queries=np.asarray(queries, np.float32), size=size)

    def on_object(self, queries: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """As `Tracker.on_object`."""
        return self._tracker.on_object(self._reduced(queries))

    def _reduced(self, queries: npt.ArrayLike) -> npt.NDArray[np.float32]:
        asked = np.array(queries, np.float32)
        edge = np.array([self._tracker.width, self._tracker.height], np.float32) - 0.5
        asked[:, 1:] = np.minimum((asked[:, 1:] + 0.5) * self._scale - 0.5, edge)  # the quotient is rounded
        return asked

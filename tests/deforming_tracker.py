"""A tracker of a deformation in closed form, exact at every place: what a perfect model would answer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from decomo_runtime import ModelFacts, Tracks

FRAMES, HEIGHT, WIDTH = 9, 60, 80
Places = npt.NDArray[np.float64]
Map = Callable[[Places, npt.NDArray[np.int64]], Places]
"""Places [..., 2] in frames, of places in frame 0."""


class DeformingTracker:
    """Answers as `decomo_runtime.Tracker` does, to queries in frame 0 and, where `back` is given, in others.

    Args:
        there: the deformation.
        back: its inverse: places in frame 0 of places in frames.
        hidden: of places in frame 0 and frames, which are hidden.
        own: of places in frame 0, which an object owns.
        times: of each frame, where they are not steady.
        pixel_aspect: of the clip.
    """

    def __init__(
        self,
        there: Map,
        back: Map | None = None,
        hidden: Callable[[Places, npt.NDArray[np.int64]], npt.NDArray[np.bool_]] | None = None,
        own: Callable[[Places], npt.NDArray[np.bool_]] | None = None,
        times: npt.ArrayLike | None = None,
        pixel_aspect: float = 1.0,
    ) -> None:
        self._there, self._back, self._hidden, self._own = there, back, hidden, own
        self.facts = ModelFacts("bent", FRAMES, HEIGHT, WIDTH, 10.0, "cpu", 0.5)
        self.facts = replace(self.facts, pixel_aspect=pixel_aspect)
        self.times = np.arange(FRAMES) / 10.0 if times is None else np.asarray(times, np.float64)

    def _start(self, queries: npt.NDArray[np.float32]) -> Places:
        places, frames = queries[:, 1:].astype(np.float64), queries[:, 0].astype(np.int64)
        if self._back is None:
            assert not frames.any()
            return places
        return self._back(places, frames)

    def track(self, queries: npt.ArrayLike, frames: npt.ArrayLike | None = None) -> Tracks:
        asked = np.asarray(queries, np.float32)
        numbers = np.arange(FRAMES) if frames is None else np.asarray(frames)
        start = self._start(asked)[:, None]
        xy = np.broadcast_to(self._there(start, numbers[None]), (len(asked), len(numbers), 2)).astype(np.float32)
        hidden = np.zeros(xy.shape[:2], bool) if self._hidden is None else self._hidden(start, numbers[None])
        hidden = np.broadcast_to(hidden, xy.shape[:2])
        xy = np.where(hidden[..., None], xy + 5, xy).astype(np.float32)  # which a hidden answer may well be off by
        return Tracks(xy, hidden, hidden.astype(np.float32), asked, numbers)

    def on_object(self, queries: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        asked = np.asarray(queries, np.float32)
        return np.zeros(len(asked), bool) if self._own is None else self._own(self._start(asked))


def affine(matrix: npt.ArrayLike, shift: npt.ArrayLike = (0, 0)) -> tuple[Map, Map]:
    """A deformation that is identity in frame 0 and `matrix` in the last one, and its inverse."""
    change, moved = np.asarray(matrix) - np.eye(2), np.asarray(shift, np.float64)

    def of(frames: npt.NDArray[np.int64]) -> tuple[Places, Places]:
        amount = np.asarray(frames, np.float64)[..., None] / (FRAMES - 1)
        return np.eye(2) + amount[..., None] * change, amount * moved

    def there(places: Places, frames: npt.NDArray[np.int64]) -> Places:
        matrices, shifts = of(frames)
        return np.einsum("...ij,...j->...i", matrices, places) + shifts

    def back(places: Places, frames: npt.NDArray[np.int64]) -> Places:
        matrices, shifts = of(frames)
        return np.einsum("...ij,...j->...i", np.linalg.inv(matrices), places - shifts)

    return there, back

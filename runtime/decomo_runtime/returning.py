"""What a window has hidden in the frames that it shares with another, and sees in others: points that come back.

Points of a grid are picked in frames of the window where they are seen, and followed to a shared frame. Those that the
model has hidden there tell what comes back out of the places where they are hidden. A point of the other window that
is hidden in such a place, of the scene or of an object as they are, is taken for their neighbour.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt

from decomo_runtime.model import Model
from decomo_runtime.queries import grid_queries

SPACING = 4.0
"""Between points of the grid, in pixels of a frame whose longer side is 256; so are the next two."""
REACH = 6.0
"""How far from a point its neighbour may be hidden."""
MISS = 2.0
"""How far from its own place a point that was found may be traced back to."""
STRIDE = 4
"""A grid is picked in one of so many frames."""
AT_ONCE = 2**17
"""Points in one of the sets in which neighbours are sought: OpenCV takes no set of twice as many."""

Floats = npt.NDArray[np.float32]


class Returning:
    """Finds points that are hidden in a shared frame again.

    Args:
        model: of the window that is entered.
        begin: its first frame in the clip.
        frame: the shared frame, of the clip.
    """

    def __init__(self, model: Callable[[], Model], begin: int, frame: int) -> None:
        self._model, self._begin = model, begin
        self.frame = frame

    def find(self, xy: Floats, on_object: npt.NDArray[np.bool_]) -> tuple[npt.NDArray[np.bool_], Floats]:
        """Whether points that are hidden at `xy` [n, 2] of the shared frame come back, [n].

        And where, [n, 3], (t, x, y) of the clip. `on_object`: whether an object owns each.
        """
        model = self._model()
        unit = max(model.facts.height, model.facts.width) / 256
        queries = np.zeros((len(xy), 3), np.float32)
        near = np.full(len(xy), -1)
        for owner in (False, True):
            rows, known = np.flatnonzero(on_object == owner), np.flatnonzero(self._hidden[2] == owner)
            if len(rows) and len(known):
                matcher = cv2.BFMatcher(cv2.NORM_L2)
                matcher.add(np.split(self._hidden[1][known], range(AT_ONCE, len(known), AT_ONCE)))
                close = [match for match in matcher.match(xy[rows]) if match.distance <= REACH * unit]
                neighbours = [match.imgIdx * AT_ONCE + match.trainIdx for match in close]
                near[rows[[match.queryIdx for match in close]]] = known[neighbours]
        rows = np.flatnonzero(near >= 0)
        if not len(rows):
            return near >= 0, queries
        asked, there, _ = self._hidden
        guess = asked[near[rows]].copy()
        guess[:, 1:] += xy[rows] - there[near[rows]]
        guess[:, 1:] = guess[:, 1:].clip(-0.5, np.array([model.facts.width, model.facts.height]) - 0.5)
        back, hidden = model.track(guess, np.array([self.frame - self._begin]))
        miss = np.linalg.norm(back[:, 0] - xy[rows], axis=1)
        right = (miss <= MISS * unit) & (hidden[:, 0] > model.facts.occlusion_threshold)
        queries[rows] = guess + np.array([self._begin, 0, 0], np.float32)
        found = np.zeros(len(xy), bool)
        found[rows[right]] = True
        return found, queries

    @cached_property
    def _hidden(self) -> tuple[Floats, Floats, npt.NDArray[np.bool_]]:
        """Queries [K, 3] of the window's own frames, where they are hidden in the shared one, whether on an object."""
        model = self._model()
        facts, here = model.facts, self.frame - self._begin
        step = max(1.0, SPACING * max(facts.height, facts.width) / 256)
        frames = [frame for frame in range(here % STRIDE, facts.num_frames, STRIDE) if frame != here]
        if not frames:
            nothing = np.empty((0, 3), np.float32)
            return nothing, nothing[:, :2], np.empty(0, bool)
        grid = [grid_queries(step, frame, facts.height, facts.width) for frame in frames]
        queries = np.concatenate(grid).astype(np.float32)
        xy, occlusion = model.track(queries, np.array([here]))
        size = np.array([facts.width, facts.height])
        inside = ((xy[:, 0] >= -0.5) & (xy[:, 0] <= size - 0.5)).all(axis=1)
        kept = inside & (occlusion[:, 0] > facts.occlusion_threshold)
        queries, xy = queries[kept], xy[kept, 0]
        return queries, xy, model.sample(queries).on_object(facts.object_share)

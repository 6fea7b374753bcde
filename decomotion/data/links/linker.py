"""Linking of the points of every frame to every other, part by part, into the arrays of the stage `links`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from decomotion.clip import Clip
from decomotion.data.config import DataConfig
from decomotion.data.links import linking
from decomotion.data.links.flow_store import FlowStore
from decomotion.data.links.layer import AT_HAND, DRAWN_TOLERANCE, Layer, Mask
from decomotion.data.links.matching import MatchStore
from decomotion.data.links.own_flow import OwnFlow, looks
from decomotion.data.links.refinement import Refiner
from decomotion.data.positions import pack
from decomotion.data.sampling import nearest, rescaled
from decomotion.data.stages import write_array, write_whole
from decomotion.memory import forget

CONFIDENT_VARIANCE = 1.0
"""Accumulated squared error, units^2, at which the confidence is one half."""
LINKED = "linked"
"""How many of the parts of linking are done: an interrupted run goes on after them."""
LINKED_AT_ONCE = 256 << 20
"""Bytes of the states of the points that are linked at a time; every further part reads the flows again."""
FOUND = "found.npy"
"""What was found to move, for an interrupted run: it has linked some of that anew."""


def parts_done(folder: Path) -> int:
    """Parts of linking that an interrupted run has left in the stage's folder."""
    file = folder / LINKED
    return int(file.read_text(encoding="ascii")) if file.is_file() else 0


Which = slice | npt.NDArray[np.int64]
"""Of the points of a frame."""
Chosen = tuple[npt.NDArray[np.float32], Sequence[Which]]
"""Points [frame, n, 2], and which of each frame they are."""


class Linker:
    """Links the points of every frame to every other, part by part."""

    def __init__(
        self,
        clip: Clip,
        working: Clip,
        config: DataConfig,
        flow: FlowStore,
        intervals: tuple[int, ...],
        matches: MatchStore,
    ) -> None:
        self._clip, self._working, self._pool, self._flow = clip, working, config.pool, flow
        self._intervals = intervals
        refine = Refiner(working)
        self._rematching = linking.Rematching(matches, matches.intervals, refine) if matches.intervals else None
        self._longest = min(len(clip), max(intervals + matches.intervals))

    def given(self, layer: Layer, progress: bool, folder: Path) -> linking.Moving:
        """What is in a layer of given masks, with its own flow."""
        return linking.Moving(self._own(layer, None, progress, folder), layer.mask, layer.reach)

    def found(self, layer: Layer, outlined: bool, progress: bool, folder: Path) -> linking.Moving:
        """What is in a layer that was found, and may be wrong, with its own flow; if `outlined`, it ends there."""
        own = self._own(layer, self._flow, progress, folder)
        if not outlined:
            return linking.Moving(own, layer.mask, None)
        size = self._flow(0, 1).shape[1::-1]
        look = lru_cache(AT_HAND)(lambda frame: looks(self._working.frames[frame], size))
        return linking.Moving(own, layer.mask, layer.reach, look)

    def _own(self, layer: Layer, every: FlowStore | None, progress: bool, folder: Path) -> OwnFlow:
        own = OwnFlow(self._working, self._flow.estimator, layer, folder / "own", every)
        own.compute(self._intervals, progress)
        return own

    def run(
        self,
        points: npt.NDArray[np.float32],
        targets: npt.NDArray[np.uint16],
        confidence: npt.NDArray[np.uint8],
        moving: linking.Moving | None,
        progress: bool,
        folder: Path,
    ) -> None:
        """Fills `targets` and `confidence`, but for the frames themselves; `folder` remembers which parts are done."""

        def chosen(which: slice) -> Chosen:
            return points[:, which], [which] * len(points)

        parts = self._parts(points.shape[1])
        self._link_parts(parts, 0, chosen, targets, confidence, moving, progress, folder)

    def run_again(
        self,
        points: npt.NDArray[np.float32],
        targets: npt.NDArray[np.uint16],
        confidence: npt.NDArray[np.uint8],
        found: Callable[[], Iterable[Mask]],
        outlined: bool,
        progress: bool,
        folder: Path,
    ) -> None:
        """Links those points anew that are `found` to move, by their own flow too, after `run`.

        A point of what is `outlined` by a network is hidden where it would leave that for a place of other looks.
        """
        if not (folder / FOUND).is_file():
            write_array(folder / FOUND, np.stack(list(found())))
        masks = np.load(folder / FOUND)
        if not masks.any():
            return
        sides, raster = (self._clip.height, self._clip.width), self._flow(0, 1).shape[:2]
        moving = self.found(Layer(masks, raster[::-1], DRAWN_TOLERANCE), outlined, progress, folder)
        moves = [nearest(mask, rescaled(xy, sides, mask.shape)) for mask, xy in zip(masks, points, strict=True)]
        some, frames = _padded(moves), np.arange(len(points))[:, None]

        def chosen(which: slice) -> Chosen:
            return points[frames, some[:, which]], list(some[:, which])

        first, parts = len(self._parts(points.shape[1])), self._parts(some.shape[1])
        self._link_parts(parts, first, chosen, targets, confidence, moving, progress, folder)

    def _parts(self, points: int) -> list[tuple[slice, int]]:
        """Which points are linked at a time, and which way in time: as many as fit into `LINKED_AT_ONCE`."""
        at_once = max(1, LINKED_AT_ONCE // (linking.BYTES_A_POINT * len(self._clip) * self._longest))
        return [(slice(first, first + at_once), step) for first in range(0, points, at_once) for step in (1, -1)]

    def _link_parts(
        self,
        parts: Sequence[tuple[slice, int]],
        before: int,
        chosen: Callable[[slice], Chosen],
        targets: npt.NDArray[np.uint16],
        confidence: npt.NDArray[np.uint8],
        moving: linking.Moving | None,
        progress: bool,
        folder: Path,
    ) -> None:
        """Those of `parts` that are not done yet; so many others come before them."""
        frames, done = len(self._clip), min(parts_done(folder) - before, len(parts))
        with tqdm(
            total=frames * len(parts), initial=frames * done, desc="link", disable=not progress, leave=False
        ) as bar:
            for number, (which, step) in enumerate(parts[done:], before + done + 1):
                self._link(*chosen(which), targets, confidence, moving, step, bar)
                write_whole(folder / LINKED, partial(Path.write_text, data=str(number), encoding="ascii"))

    def _link(
        self,
        points: npt.NDArray[np.float32],
        which: Sequence[Which],
        targets: npt.NDArray[np.uint16],
        confidence: npt.NDArray[np.uint8],
        moving: linking.Moving | None,
        step: int,
        bar: tqdm,
    ) -> None:
        """Of `points` [frame, n, 2], which are those points of each frame."""
        pool, sides, raster = self._pool, (self._clip.height, self._clip.width), self._flow(0, 1).shape[:2]
        on_raster = rescaled(points, sides, raster)
        how = (pool.cycle_threshold, pool.max_gap, step, self._rematching, moving)
        for links in linking.link(on_raster, self._flow, self._intervals, *how):
            for source, xy, variance, occluded in zip(
                links.sources, links.xy, links.variance, links.occluded, strict=True
            ):
                targets[source, links.target, which[source]] = pack(rescaled(xy, raster, sides), max(sides))
                certain = np.float32(255 * CONFIDENT_VARIANCE) / (np.float32(CONFIDENT_VARIANCE) + variance)
                certain[occluded] = 0
                confidence[source, links.target, which[source]] = np.round(certain)
            forget(targets)
            forget(confidence)
            bar.update()


def _padded(chosen: Sequence[npt.NDArray[np.bool_]]) -> npt.NDArray[np.int64]:
    """[frame, n]: the places of those `chosen`, the first as often as it takes; that of none is 0."""
    places = [np.flatnonzero(each) if each.any() else np.zeros(1, np.int64) for each in chosen]
    most = max(len(each) for each in places)
    return np.stack([np.append(each, np.full(most - len(each), each[0])) for each in places])

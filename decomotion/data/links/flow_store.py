"""Flow fields at the scheduled gaps, on disk: both ways, the shorter gaps first.

An estimator that searches from zero loses what moves far. One that can be given a start (`FlowEstimator.guided`)
searches from where the pixels are already thought to be. Longer gaps start at fields of shorter ones, one after the
other. Neighbouring frames are searched from zero, and a second time from matches by appearance where the first answer
does not return and the matches lead elsewhere; pixel by pixel that answer stays which the way back brings nearer to
where it began.

Fields are files `<first>_<second>.npy`, float16; a killed run's are found again.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import torch
from tqdm import tqdm

from decomotion.clip import Clip
from decomotion.data.flow import Flow, FlowEstimator
from decomotion.data.flow.interface import kept, to_raster
from decomotion.data.links.intervals import couples_of
from decomotion.data.links.linking import cycle_error
from decomotion.data.links.matcher import Matches
from decomotion.data.links.matching import MatchStore
from decomotion.data.links.pair_files import Couple, PairFiles
from decomotion.data.sampling import bilinear, pixels
from decomotion.data.timing import least_seconds
from decomotion.images import filled
from decomotion.units import unit

BothWays = tuple[Flow, Flow]
"""From the earlier frame to the later one, and back."""

MARGIN = 0.1
"""The start has to bring the way back nearer by this much, in pixels of a frame whose longer side is 256."""


ELSEWHERE = 1.0
"""A start that is this far from an answer, in the same pixels, can lead to another one."""
DOUBTED = 0.01
"""Share of the pixels for which a second search is worth its time."""


@dataclass(frozen=True)
class FlowStore:
    """Fields on disk.

    Args:
        clip: the frames.
        estimator: of their flow.
        matches: between neighbours, where the estimator is to start at them.
        folder: of the files.
        beside: share of a frame that is searched once more, by itself (`own_flow.py`).
    """

    clip: Clip
    estimator: FlowEstimator
    matches: MatchStore
    folder: Path
    beside: float = 0.0
    _took: list[float] = field(default_factory=list, init=False)
    """Seconds of each search, of a field one way or the other."""

    @property
    def _files(self) -> PairFiles:
        return PairFiles(self.folder)

    def compute(self, gaps: Sequence[int], progress: bool, only: slice = slice(None)) -> int:
        """Makes the fields at `gaps`, ascending, that are not there yet; returns how many these gaps have.

        `only` takes some of each gap's couples of frames.
        """
        self.folder.mkdir(exist_ok=True)
        couples = {gap: couples_of(gap, len(self.clip))[only] for gap in gaps}
        missing = {gap: [couple for couple in couples[gap] if not self._files.have(couple)] for gap in gaps}
        total, left = (2 * sum(len(part) for part in parts.values()) for parts in (couples, missing))
        with tqdm(total=total, initial=total - left, desc="flow", disable=not progress, leave=False) as bar:
            for gap in gaps:
                shorter = [other for other in gaps if other < gap]
                for _ in each_of(partial(self._make, shorter=shorter), missing[gap], self.estimator.concurrent):
                    bar.update(2)
        return total

    def seconds(self, fields: int) -> float:
        """What so many between neighbours will take on this machine, at most, by the time of the first."""
        first, second = self.clip.frames[:2]
        with _one_thread_each(self.estimator.concurrent):
            each = least_seconds(lambda: self.estimator(first, second, (0, 1)))
        return fields * each * self.effort(1) / at_once(self.estimator)

    def seconds_a_search(self) -> float:
        """What one has taken at the least, of those that were made, where as many are made at once as may be.

        Other work on the machine makes some dearer, never cheaper.
        """
        return min(self._took) / at_once(self.estimator)

    def effort(self, gap: int) -> float:
        """What a field at that gap takes at most, in searches between neighbours, where a second one may follow."""
        searches = 2 if self.estimator.guided and gap == 1 and gap in self.matches.gaps else 1
        return (searches + self.beside) * self.estimator.effort(gap)

    def __call__(self, first: int, second: int) -> Flow:
        """From frame `first` to frame `second`, float32 [h, w, 2]."""
        return self._files.read(first, second).astype(np.float32)

    def _make(self, couple: Couple, shorter: Sequence[int]) -> None:
        guided = self.estimator.guided
        if guided and shorter:
            stops = _stops(*couple, shorter)
            both = self._ask(couple, (self._chained(stops), self._chained(stops[::-1])))
        else:
            both = self._ask(couple, (None, None))
            if guided and (starts := self._matched(couple)) is not None and doubtful(both, starts):
                both = nearer(both, self._ask(couple, starts))
        for (first, second), flow in zip((couple, couple[::-1]), both, strict=True):
            self._files.write(first, second, flow.astype(np.float16))

    def _ask(self, couple: Couple, starts: tuple[Flow | None, Flow | None]) -> BothWays:
        frames, begin = self.clip.frames, time.monotonic()
        there, back = (
            self.estimator(frames[first], frames[second], (first, second), start)
            for (first, second), start in zip((couple, couple[::-1]), starts, strict=True)
        )
        self._took.append((time.monotonic() - begin) / 2)
        return there, back

    def _matched(self, couple: Couple) -> BothWays | None:
        """Where matches lead, in both directions; None where there are none."""
        first, second = couple
        if second - first not in self.matches.gaps:
            return None
        size = kept(self.clip.height, self.clip.width, self.estimator.field_side)
        there, back = self.matches(first, second), self.matches(second, first)
        return to_raster(smooth(there), size), to_raster(smooth(back), size)

    def _chained(self, stops: Sequence[int]) -> Flow:
        """The flow from the first of `stops` to the last, from hop to hop."""
        chain, *hops = [self(here, there) for here, there in pairwise(stops)]
        for hop in hops:
            chain = chain + bilinear(hop, _grid(chain) + chain)
        return chain


def doubtful(both: BothWays, starts: BothWays) -> bool:
    """Whether there is anything to be gained from a search from `starts`: on `DOUBTED` of the pixels one way or other.

    There the answer does not return to where it began, and the start is elsewhere.
    """
    length = unit(*both[0].shape[:2])
    for there, back, start in ((both[0], both[1], starts[0]), (both[1], both[0], starts[1])):
        astray = _errors(there, back) > MARGIN * length
        elsewhere = np.abs(start - there).max(axis=-1) > ELSEWHERE * length
        if (astray & elsewhere).mean() > DOUBTED:
            return True
    return False


def nearer(both: BothWays, others: BothWays) -> BothWays:
    """Pixel by pixel the answer that leads back nearer to where it began; `both` unless `others` do so by `MARGIN`."""
    margin = MARGIN * unit(*both[0].shape[:2])
    chosen = []
    for there, back in ((0, 1), (1, 0)):
        errors, errors_of_others = (_errors(ways[there], ways[back]) for ways in (both, others))
        better = errors_of_others < errors - margin
        chosen.append(np.where(better[..., None], others[there], both[there]))
    return chosen[0], chosen[1]


def smooth(matches: Matches) -> Flow:
    """The trusted displacements, continued over the cells without, in cells [h, w, 2]."""
    everywhere = filled(matches.displacement, matches.trusted.astype(np.float32))
    axes = [cv2.medianBlur(np.ascontiguousarray(axis), 3) for axis in np.moveaxis(everywhere, -1, 0)]
    return np.stack(axes, axis=-1).astype(np.float32)


def _errors(there: Flow, back: Flow) -> Flow:
    grid = _grid(there)
    return cycle_error(grid, grid + there, back)


def _grid(flow: Flow) -> Flow:
    """The pixels of its raster, not to be written to."""
    return pixels(*flow.shape[:2])


def _stops(first: int, second: int, gaps: Sequence[int]) -> list[int]:
    """Frames from `first` to `second`, each one of `gaps` after the last, in as few hops as the longest allow."""
    stops = [first]
    while stops[-1] < second:
        stops.append(stops[-1] + max(gap for gap in gaps if gap <= second - stops[-1]))
    return stops


def threads() -> int:
    """How many threads may work at once: as many as torch has, and no more than the process has cores."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(cores, torch.get_num_threads())


def at_once(estimator: FlowEstimator) -> int:
    """How many fields are made at a time."""
    return threads() if estimator.concurrent else 1


def each_of(task: Callable[[Couple], None], couples: Iterable[Couple], concurrent: bool) -> Iterator[None]:
    """Does a task for each of some couples, several at a time where that is `concurrent`."""
    if not concurrent:
        yield from map(task, couples)
        return
    with _one_thread_each(concurrent), ThreadPoolExecutor(threads()) as pool:
        yield from pool.map(task, couples)


@contextmanager
def _one_thread_each(concurrent: bool) -> Iterator[None]:
    """One couple a thread is faster than every thread on one."""
    former = cv2.getNumThreads()
    cv2.setNumThreads(1 if concurrent else former)
    try:
        yield
    finally:
        cv2.setNumThreads(former)

"""Flow fields at the scheduled gaps, on disk: both ways, the shorter gaps first.

An estimator that searches from zero loses what moves far. One that can be given a start (`FlowEstimator.guided`) is
therefore asked twice: from zero, and from where the pixels are already thought to be. Neighbouring frames start at
matches by appearance, longer gaps at fields of shorter ones, one after the other. Pixel by pixel that answer stays
which the way back brings nearer to where it began.

Fields are files `<first>_<second>.npy`, float16; a killed run's are found again.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
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
from decomotion.data.links.matching import Matches, MatchStore
from decomotion.data.links.pair_files import Couple, PairFiles
from decomotion.data.sampling import bilinear
from decomotion.data.timing import least_seconds
from decomotion.images import filled
from decomotion.units import unit

BothWays = tuple[Flow, Flow]
"""From the earlier frame to the later one, and back."""

MARGIN = 0.1
"""The start has to bring the way back nearer by this much, in pixels of a frame whose longer side is 256."""


@dataclass(frozen=True)
class FlowStore:
    """Fields on disk.

    Args:
        clip: the frames.
        estimator: of their flow.
        matches: between neighbours, where the estimator is to start at them.
        folder: of the files.
    """

    clip: Clip
    estimator: FlowEstimator
    matches: MatchStore
    folder: Path

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
                for _ in _each(partial(self._make, shorter=shorter), missing[gap], self.estimator.concurrent):
                    bar.update(2)
        return total

    def seconds(self, fields: int) -> float:
        """What so many will take on this machine, about: by the time of the first."""
        first, second = self.clip.frames[:2]
        with _one_thread_each(self.estimator.concurrent):
            each = least_seconds(lambda: self.estimator(first, second, (0, 1)))
        return fields * each * (1 + self.estimator.guided) / at_once(self.estimator)

    def __call__(self, first: int, second: int) -> Flow:
        """From frame `first` to frame `second`, float32 [h, w, 2]."""
        return self._files.read(first, second).astype(np.float32)

    def _make(self, couple: Couple, shorter: Sequence[int]) -> None:
        both = self._ask(couple, (None, None))
        if self.estimator.guided and (starts := self._starts(couple, shorter)) is not None:
            both = nearer(both, self._ask(couple, starts))
        for (first, second), flow in zip((couple, couple[::-1]), both, strict=True):
            self._files.write(first, second, flow.astype(np.float16))

    def _ask(self, couple: Couple, starts: tuple[Flow | None, Flow | None]) -> BothWays:
        frames = self.clip.frames
        there, back = (
            self.estimator(frames[first], frames[second], (first, second), start)
            for (first, second), start in zip((couple, couple[::-1]), starts, strict=True)
        )
        return there, back

    def _starts(self, couple: Couple, shorter: Sequence[int]) -> BothWays | None:
        """Where pixels are thought to be, in both directions; None where nothing is known."""
        first, second = couple
        if shorter:
            stops = _stops(first, second, shorter)
            return self._chained(stops), self._chained(stops[::-1])
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
    height, width = flow.shape[:2]
    return np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).astype(np.float32)


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


def _each(task: Callable[[Couple], None], couples: Iterable[Couple], concurrent: bool) -> Iterator[None]:
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

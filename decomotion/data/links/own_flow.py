"""Flow of what moves alone, at the scheduled gaps, on disk: both ways.

Fields are files `<first>_<second>.npy`, float16; a killed run's are found again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from tqdm import tqdm

from decomotion.clip import Clip
from decomotion.data.flow import Flow, FlowEstimator
from decomotion.data.links.flow_store import each_of
from decomotion.data.links.intervals import couples_of
from decomotion.data.links.layer import Layer
from decomotion.data.links.pair_files import Couple, PairFiles


@dataclass(frozen=True)
class OwnFlow:
    """Fields on disk.

    Args:
        clip: the frames.
        estimator: of their flow.
        layer: what moves.
        folder: of the files.
    """

    clip: Clip
    estimator: FlowEstimator
    layer: Layer
    folder: Path

    def compute(self, gaps: Sequence[int], progress: bool) -> None:
        """Makes the fields at `gaps` that are not there yet."""
        self.folder.mkdir(exist_ok=True)
        couples = [couple for gap in gaps for couple in couples_of(gap, len(self.clip))]
        missing = [couple for couple in couples if not self._files.have(couple)]
        total, left = 2 * len(couples), 2 * len(missing)
        with tqdm(total=total, initial=total - left, desc="own flow", disable=not progress, leave=False) as bar:
            for _ in each_of(self._make, missing, self.estimator.concurrent):
                bar.update(2)

    def __call__(self, first: int, second: int) -> Flow:
        """From frame `first` to frame `second`, float32 [h, w, 2]."""
        return self._files.read(first, second).astype(np.float32)

    @property
    def _files(self) -> PairFiles:
        return PairFiles(self.folder)

    def _make(self, couple: Couple) -> None:
        for first, second in (couple, couple[::-1]):
            frames = self.clip.frames[first], self.clip.frames[second]
            flow = self.layer.flow(self.estimator, frames, (first, second))
            self._files.write(first, second, flow.astype(np.float16))

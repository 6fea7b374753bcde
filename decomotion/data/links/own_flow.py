"""Flow of what moves alone, at the scheduled gaps, on disk: both ways.

What given masks hold moves so. What is found to move may be the scene beside it: the flow of all stays where it returns
to where it began, and the colours that it leads to are as near; and wherever nothing moves.

Files `<first>_<second>.npy`, float16, have the part of each field that is searched; a killed run's are found again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from decomotion.clip import Clip
from decomotion.data.flow import Flow, FlowEstimator, Frame
from decomotion.data.flow.interface import Size, resized
from decomotion.data.links.flow_store import each_of
from decomotion.data.links.intervals import couples_of
from decomotion.data.links.layer import Layer
from decomotion.data.links.linking import FlowLookup, cycle_error
from decomotion.data.links.pair_files import Couple, PairFiles
from decomotion.data.sampling import bilinear, pixels
from decomotion.units import unit

BLUR = 0.4
"""Standard deviation in units by which colours are blurred before they are compared."""
WINDOW = 2.5
"""Units over which they are compared."""
RETURNS = 1.0
"""Units by which flow of all may miss where it began."""


@dataclass(frozen=True)
class OwnFlow:
    """Fields on disk.

    Args:
        clip: the frames.
        estimator: of their flow.
        layer: what moves.
        folder: of the files.
        every: `every(i, j)` is the flow of all from frame i to frame j, [h, w, 2], where what moves was found.
    """

    clip: Clip
    estimator: FlowEstimator
    layer: Layer
    folder: Path
    every: FlowLookup | None = None

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
        flow = self.layer.empty() if self.every is None else self.every(first, second)
        if (part := self.layer.part(first, second)) is not None:
            flow[part] = self._files.read(first, second)
        return flow

    @property
    def _files(self) -> PairFiles:
        return PairFiles(self.folder)

    def _make(self, couple: Couple) -> None:
        for first, second in (couple, couple[::-1]):
            frames = self.clip.frames[first], self.clip.frames[second]
            flow = self.layer.flow(self.estimator, frames, (first, second))
            if self.every is not None:
                every = self.every(first, second)
                likely = likelier(*frames, flow, every, self.every(second, first))
                flow = np.where(self.layer.mask(first)[..., None], likely, every)
            part = self.layer.part(first, second)
            self._files.write(first, second, (flow[:0, :0] if part is None else flow[part]).astype(np.float16))


def likelier(frame: Frame, other: Frame, own: Flow, there: Flow, back: Flow) -> Flow:
    """From one frame to another [H, W, 3] `own` flow [h, w, 2], but `there` where that is as likely.

    It returns by `back` within `RETURNS` units, and the colours that it leads to are as near over `WINDOW` units.
    """
    size = own.shape[1::-1]
    here, elsewhere = (looks(image, size) for image in (frame, other))
    nearer = _difference(here, elsewhere, own) < _difference(here, elsewhere, there)
    grid = pixels(*own.shape[:2])
    lost = cycle_error(grid, grid + there, back) > RETURNS * unit(*size)
    return np.where((nearer | lost)[..., None], own, there)


def looks(frame: Frame, size: Size) -> Frame:
    """A frame [H, W, 3] brought to the raster of the fields, of that width and height, its colours to be compared."""
    return cv2.GaussianBlur(resized(frame, size), (0, 0), BLUR * unit(*size)).astype(np.uint8)


def _difference(here: Frame, there: Frame, flow: Flow) -> npt.NDArray[np.float32]:
    """Of colours, [h, w], the mean over channels and a window."""
    where = (pixels(*flow.shape[:2]) + flow).astype(np.float32)
    brought = bilinear(there, where)
    side = max(1, round(WINDOW * unit(*flow.shape[:2])))
    return cv2.blur(np.abs(brought - here.astype(np.float32)).mean(axis=-1), (side, side))

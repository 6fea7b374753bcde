"""Matching: places of one frame found again in another by what they look like, whatever happened in between.

Flow follows a point while it moves a little at a time; what was hidden for longer than its gaps, or moved too fast, is
lost to it. Matches are less precise than flow, so that linking takes one where flow is lost or has added up a larger
error (`decomotion/data/links/linking.py`).
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from tqdm import tqdm

from decomotion.clip import Clip
from decomotion.data.links.config import MatchingConfig
from decomotion.data.links.intervals import couples_of
from decomotion.data.links.matcher import Matcher, Matches
from decomotion.data.links.pair_files import Couple, PairFiles

DESCRIBED = "described"
"""The folder for what a matcher keeps of all frames, beside the matches while these are made."""


def build_matcher(config: MatchingConfig, device: str = "cpu") -> Matcher:
    """The matcher that `config` describes; those with weights load them here and run on `device`.

    Raises `SupervisionError` where weights cannot be had or do not fit.
    """
    if config.kind == "sift":
        from decomotion.data.links.sift_matching import SiftMatcher

        return SiftMatcher(config.supporters)
    from decomotion.data.links.keypoint_matching import KeypointMatcher

    return KeypointMatcher(config.kind, config.weights, device)


class MatchStore:
    """The matches between all frames that are one of some gaps apart, on disk.

    A file `<first>_<second>.npy` each, float32 [h, w, 3]: displacement and trust; a killed run's are found again.

    Args:
        clip: the frames.
        intervals: gaps that are matched.
        matcher: of the frames.
        folder: of the files.
        neighbours: match neighbouring frames, too, unless nothing is matched.
    """

    def __init__(
        self, clip: Clip, intervals: Sequence[int], matcher: Matcher, folder: Path, neighbours: bool = False
    ) -> None:
        self.intervals = tuple(gap for gap in intervals if gap < len(clip))
        """Gaps over which points are to be linked."""
        self.gaps = sorted({*self.intervals, *((1,) if neighbours and intervals else ())})
        """All that are matched."""
        self._clip, self._matcher, self._files = clip, matcher, PairFiles(folder)

    def compute(self, progress: bool) -> None:
        """Makes the matches that are not there yet."""
        self._files.folder.mkdir(exist_ok=True)
        missing = self._missing()
        if not missing:
            return
        described = self._files.folder / DESCRIBED
        shutil.rmtree(described, ignore_errors=True)
        described.mkdir()
        match = self._matcher.describe(self._clip, described, progress)
        for first, second in tqdm(missing, "match", disable=not progress, leave=False):
            for way, matches in zip(((first, second), (second, first)), match(first, second), strict=True):
                self._files.write(*way, np.dstack([matches.displacement, matches.trusted]).astype(np.float32))
        shutil.rmtree(described)

    def seconds(self) -> float:
        """What `compute` will take on this machine, about."""
        missing = self._missing()
        if not missing:
            return 0.0
        of_frame, of_pair = self._matcher.seconds(self._clip)
        return len(self._clip) * of_frame + len(missing) * of_pair

    def _missing(self) -> list[Couple]:
        couples = [couple for gap in self.gaps for couple in couples_of(gap, len(self._clip))]
        return [couple for couple in couples if not self._files.have(couple)]

    def __call__(self, first: int, second: int) -> Matches:
        """From frame `first` to frame `second`."""
        content = self._files.read(first, second)
        return Matches(content[..., :2], content[..., 2] > 0)

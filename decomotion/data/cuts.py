"""Where a clip cuts from one shot to another: no motion leads across, and a fit across fails in silence."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from statistics import median

from decomotion.data.likeness import StructureImage, likeness, structure_of
from decomotion.frames import AnyFrames, Frames
from decomotion.greys import small_grey

LIKE = 0.04
"""Frames of one shot have at least this share of their structure in common."""
FALL = 0.2
"""Or this share of what is usual around them: some motion is too fast to follow."""
AROUND = 3
"""Steps on either side that say what is usual."""
DIP = 0.85
"""A blend of two shots is alike to one of its neighbours by less than this share of what is usual."""
REACH = 6
"""Frames between two that are compared at most: a flash, or an object before the lens, is over by then."""
KEPT = 32
"""Frames whose structure is kept: more than are compared with each other at a time."""


def find_cuts(frames: AnyFrames) -> list[int]:
    """The first frame of each shot but the first, ascending; `frames` are [T, H, W, 3] RGB, of which few are kept.

    A cut is where no frame shortly before goes together with one shortly after (`likeness.py`). A frame between, a
    blend of both or like neither, belongs to the shot that it is more like. What is over after `REACH` frames is no
    cut. Frames without structure, black or white, belong to the shot before them. Where most steps around lead
    nowhere, the motion is too fast, and nothing is a cut.

    So dissolves over more than a frame, and shots of a frame or two in a row, are not found; nor are all cuts between
    frames whose longer side has less than about 100 pixels, which are alike by chance.
    """
    clip = _Structures(frames)
    broken = {place for place in range(clip.num_steps) if clip.breaks_at(place)}
    broken |= {clip.weaker_step(odd) for odd in range(1, clip.num_steps) if clip.is_blend(odd)}
    return [clip.numbers[place + 1] for place in _one_of_each_row(sorted(broken), clip.steps)]


class _Structures:
    """Of the frames that have one. Step n leads from frame n to the next."""

    def __init__(self, frames: AnyFrames) -> None:
        self._frames = frames
        self._structure = lru_cache(KEPT)(self._made)
        self._known: dict[tuple[int, int], float] = {}
        self.numbers: list[int] = []
        """Of these frames among all."""
        self.steps: list[float] = []
        """The likeness of each step."""
        for number in range(len(frames)):
            if self._structure(number) is not None:
                self.numbers.append(number)
                if len(self.numbers) > 1:
                    self.steps.append(self._likeness(len(self.numbers) - 2, len(self.numbers) - 1))
        self.num_steps = len(self.steps)

    def _made(self, number: int) -> StructureImage | None:
        frames = self._frames
        return structure_of(frames.grey(number) if isinstance(frames, Frames) else small_grey(frames[number]))

    def breaks_at(self, place: int) -> bool:
        """Whether nothing leads across a step."""
        return not self._leads_across(place, place + 1, self._usual(place))

    def is_blend(self, odd: int) -> bool:
        """Whether nothing leads across a frame, though frames as far apart are alike on either side of it."""
        weaker = self.weaker_step(odd)
        if self.steps[weaker] >= DIP * self._usual(weaker) or odd < 3 or odd > self.num_steps - 3:
            return False
        usual = min(self._likeness(odd - 3, odd - 1), self._likeness(odd + 1, odd + 3))
        return not self._leads_across(odd - 1, odd + 1, usual)

    def _usual(self, place: int) -> float:
        """The likeness of the steps around one."""
        around = [*self.steps[max(0, place - AROUND) : place], *self.steps[place + 1 : place + 1 + AROUND]]
        return median(around) if around else 1.0

    def weaker_step(self, number: int) -> int:
        """Of the two steps to and from a frame."""
        return min(number - 1, number, key=self.steps.__getitem__)

    def _leads_across(self, before: int, after: int, usual: float) -> bool:
        """Whether a frame up to `before` and one from `after` on go together; the nearer ones are compared first."""
        least = min(LIKE, FALL * usual)
        return any(
            self._likeness(first, first + gap) >= least
            for gap in range(after - before, after - before + REACH + 1)
            for first in range(max(0, after - gap), min(before + 1, len(self.numbers) - gap))
        )

    def _likeness(self, first: int, second: int) -> float:
        if (first, second) not in self._known:
            self._known[first, second] = likeness(self._at(first), self._at(second))
        return self._known[first, second]

    def _at(self, place: int) -> StructureImage:
        structure = self._structure(self.numbers[place])
        assert structure is not None, "frames without structure are not numbered"
        return structure


def _one_of_each_row(broken: Sequence[int], steps: Sequence[float]) -> list[int]:
    """One of each row of broken steps, the most unlike: what lies between two shots is no shot."""
    rows: list[list[int]] = []
    for place in broken:
        if rows and rows[-1][-1] == place - 1:
            rows[-1].append(place)
        else:
            rows.append([place])
    return [min(row, key=steps.__getitem__) for row in rows]

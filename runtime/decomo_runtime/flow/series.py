"""Which pairs of frames are written, and under which names: a folder for each series, a file for each pair.

A series has one number that changes, and its files are named by it, as compositors take image sequences:

    from-00003/00007    from frame 3 to frame 7, and likewise to others
    to-00003/00007      from frame 7 to frame 3, and likewise from others
    next/00007          from frame 7 to frame 8
    previous/00008      from frame 8 to frame 7
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from operator import index
from typing import Literal, SupportsIndex

from decomo_runtime.errors import FlowError

ALL, NEXT = "all", "next"
Origin = SupportsIndex | Literal["all"]
Target = SupportsIndex | Literal["all", "next"]


@dataclass(frozen=True)
class Series:
    """Pairs of frames, whose files lie in one folder."""

    folder: str
    pairs: Sequence[tuple[int, int]]
    """(from, to)."""
    numbers: Sequence[int]
    """By which the files are named."""

    def by_origin(self) -> Iterator[tuple[int, list[int]]]:
        """Pairs that may be asked for together: a frame, and those to which they lead."""
        if len({origin for origin, _ in self.pairs}) == 1:
            yield self.pairs[0][0], [target for _, target in self.pairs]
            return
        for origin, target in self.pairs:
            yield origin, [target]


def series_of(origin: Origin, target: Target, both: bool, num_frames: int) -> list[Series]:
    """What is asked for, and with `both` the opposite direction as well.

    A frame and itself are a pair too, so that a sequence has no gap. `FlowError` where a frame is none of the clip, or
    `both` says nothing.
    """
    start = ALL if origin == ALL else _checked("from", origin, (ALL,), num_frames)
    end = target if target in (ALL, NEXT) else _checked("to", target, (ALL, NEXT), num_frames)
    every = range(num_frames)
    if end == NEXT:
        firsts = every[start : start + 1] if isinstance(start, int) else every[:-1]
        if not firsts or firsts[-1] + 1 == num_frames:
            raise FlowError(f"--to {NEXT}: frame {num_frames - 1} is the clip's last; give an earlier one as --from")
        seconds = [first + 1 for first in firsts]
        found = [Series(NEXT, list(zip(firsts, seconds, strict=True)), firsts)]
        return found + ([Series("previous", list(zip(seconds, firsts, strict=True)), seconds)] if both else [])
    if isinstance(start, int):
        targets = [end] if isinstance(end, int) else every
        return [_from(start, targets)] + ([_to(start, targets)] if both else [])
    if isinstance(end, int):
        return [_to(end, every)] + ([_from(end, every)] if both else [])
    if both:
        raise FlowError("--from all --to all goes in both directions already; leave out --both")
    return [_from(each, every) for each in every]


def _checked(name: str, frame: object, words: Sequence[str], num_frames: int) -> int:
    """A frame's number, also one of numpy's; `FlowError` where it is none of the clip."""
    if isinstance(frame, bool) or not isinstance(frame, SupportsIndex):
        raise FlowError(f"--{name} {frame} is neither a frame's number, counted from 0, nor {' or '.join(words)}")
    if not 0 <= index(frame) < num_frames:
        raise FlowError(f"--{name} {frame} must be within 0 .. {num_frames - 1}, the clip's frames")
    return index(frame)


def _from(origin: int, targets: Sequence[int]) -> Series:
    return Series(f"from-{origin:05d}", [(origin, target) for target in targets], targets)


def _to(target: int, origins: Sequence[int]) -> Series:
    return Series(f"to-{target:05d}", [(origin, target) for origin in origins], origins)

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
from typing import Literal

from decomo_runtime.errors import FlowError

ALL, NEXT = "all", "next"
Origin = int | Literal["all"]
Target = int | Literal["all", "next"]


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
    for name, frame in (("from", origin), ("to", target)):
        if isinstance(frame, int) and not 0 <= frame < num_frames:
            raise FlowError(f"--{name} {frame} must be within 0 .. {num_frames - 1}, the clip's frames")
    every = range(num_frames)
    if target == NEXT:
        firsts = every[:-1] if origin == ALL else every[origin : origin + 1]
        if not firsts or firsts[-1] + 1 == num_frames:
            raise FlowError(f"--to {NEXT}: frame {num_frames - 1} is the clip's last; give an earlier one as --from")
        seconds = [first + 1 for first in firsts]
        found = [Series(NEXT, list(zip(firsts, seconds, strict=True)), firsts)]
        return found + ([Series("previous", list(zip(seconds, firsts, strict=True)), seconds)] if both else [])
    if isinstance(origin, int):
        targets = [target] if isinstance(target, int) else every
        return [_from(origin, targets)] + ([_to(origin, targets)] if both else [])
    if isinstance(target, int):
        return [_to(target, every)] + ([_from(target, every)] if both else [])
    if both:
        raise FlowError("--from all --to all goes in both directions already; leave out --both")
    return [_from(each, every) for each in every]


def _from(origin: int, targets: Sequence[int]) -> Series:
    return Series(f"from-{origin:05d}", [(origin, target) for target in targets], targets)


def _to(target: int, origins: Sequence[int]) -> Series:
    return Series(f"to-{target:05d}", [(origin, target) for origin in origins], origins)

"""What a damaged recording has lost: how many frames, and where, from what decoding it met and from the frames' times.

Times are seconds; frames are counted as they are kept, from 0.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

PLACES = 5
"""Places that the sentence names."""
_GAP = 1.5
"""Usual distances between frames from which on some are missing."""
UNEVEN = 0.1
"""Share of gaps from which on they are the recording's own uneven rate."""


@dataclass
class Loss:
    """What did not decode."""

    behind: int
    """Frames kept before it was met; decoders give frames late, so it may lie some frames further on."""
    time: float | None
    """When it was to be shown, where the file says so."""


@dataclass
class Met:
    """What decoding a video has met."""

    times: list[float | None] = field(default_factory=list)
    """Of each frame that is kept, where the file says it."""
    keys: list[bool] = field(default_factory=list)
    """Whether each builds on no other."""
    decode_times: list[float | None] = field(default_factory=list)
    """Of each coded frame, in the file's order."""
    losses: list[Loss] = field(default_factory=list)
    ended: bool = False
    """Whether the file was read to its end."""
    unread: int = 0
    """Frames that the file announces and that never came: it ends before them."""


def lost_frames(name: str, met: Met, times: npt.NDArray[np.float64] | None) -> str | None:
    """The sentence that says what `name` has lost; None: nothing.

    `times` [T] are those of the frames kept, from 0; where they are None, not known, frames that went without a trace
    are not found.
    """
    places = _by_order(met) if times is None else _by_time(met, times)
    if met.unread:
        last = len(met.times) - 1
        places[last] = places.get(last, 0) + met.unread
    if not places:
        return None
    count, known = sum(places.values()), met.losses or met.unread
    frames = f"{count} frame{'s' if count > 1 else ''}"
    what = f"{name} is damaged and has lost {frames}" if known else f"{name} lacks {frames}, or stood still"
    where = [_where(number, place, times) for place, number in sorted(places.items())]
    more = f" and at {len(where) - PLACES} more places" if len(where) > PLACES else ""
    kept = f"the other {len(met.times)} are kept and counted from 0"
    return f"{what}: {', '.join(where[:PLACES])}{more}; {kept}{_marred(met, places)}"


def _where(number: int, place: int, times: npt.NDArray[np.float64] | None) -> str:
    if place < 0:
        return f"{number} before the first that is kept"
    return f"{number} after frame {place}{'' if times is None else f' ({times[place]:.2f} s)'}"


def _by_order(met: Met) -> dict[int, int]:
    """How many frames are lost behind which, by when decoding met it."""
    return dict(Counter(loss.behind - 1 for loss in met.losses))


def _by_time(met: Met, times: npt.NDArray[np.float64]) -> dict[int, int]:
    """The same by the times of what did not decode, and by gaps in those of the frames where they are else even."""
    begin = met.times[0] or 0.0
    places = Counter(
        loss.behind - 1 if loss.time is None else int(np.searchsorted(times, loss.time - begin)) - 1
        for loss in met.losses
    )
    steps = np.diff(times)
    usual = np.median(steps) if len(steps) else 0.0
    gaps = np.flatnonzero(steps > _GAP * usual)
    if len(gaps) <= max(1, UNEVEN * len(steps)):
        for place in gaps.tolist():
            places[place] = max(places[place], round(steps[place] / usual) - 1)
    return dict(places)


def _marred(met: Met, places: Collection[int]) -> str:
    """Says which frames build on lost ones: up to the next key frame."""
    marred, after_loss = [], False
    for frame, key in enumerate(met.keys):
        after_loss = not key and (after_loss or frame - 1 in places)
        if after_loss:
            marred.append(frame)
    if not marred or not met.losses:
        return ""
    return f"; {len(marred)} of frames {marred[0]} to {marred[-1]} build on lost ones and may be smeared"

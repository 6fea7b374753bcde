"""Corrected points of a clip of several windows: what each window knows of them.

A point that is corrected from one window to another is handed over at the middle of the frames that they share, as
tracks are. Where it is there nobody has said: there the track that comes from one correction and that which comes back
from the other are blended by time, and each window learns to lead to that place.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from decomotion.corrections.points import CorrectedPoint, Place
from decomotion.errors import CorrectionError
from decomotion.windows import Windows

Follow = Callable[[int, Place], npt.NDArray[np.floating]]
"""The track [T, 2] of a place in a window, frames counted in the window, as its model has it."""


def in_windows(points: Sequence[CorrectedPoint], layout: Windows, follow: Follow) -> dict[int, list[CorrectedPoint]]:
    """The windows that have something to learn, each with its points, in frames counted from its first.

    Raises `CorrectionError` where a point is corrected from one shot to another.
    """
    found: dict[int, list[CorrectedPoint]] = {}
    for point in points:
        for number, places in _divided(point, layout, follow).items():
            begin = layout.windows[number].begin
            part = CorrectedPoint.of([place._replace(t=place.t - begin) for place in places])
            if len(part.frames) and len(part.frames) + len(part.hidden) > 1:
                found.setdefault(number, []).append(part)
    return dict(sorted(found.items()))


def _divided(point: CorrectedPoint, layout: Windows, follow: Follow) -> dict[int, list[Place]]:
    places = point.places
    homes = layout.home(np.array([place.t for place in places])).tolist()
    divided: dict[int, list[Place]] = {home: [] for home in homes}
    for home, place in zip(homes, places, strict=True):
        divided[home].append(place)
    known = [(home, place) for home, place in zip(homes, places, strict=True) if not math.isnan(place.x)]
    for one, other in pairwise(known):
        there = _handed_over(*one, other[0], layout, follow)
        back = _handed_over(*other, one[0], layout, follow)
        for seam in range(one[0], other[0]):
            share = np.clip((there[seam].t - one[1].t) / (other[1].t - one[1].t), 0, 1)
            x, y = ((1 - share) * a + share * b for a, b in zip(there[seam][1:], back[seam][1:], strict=True))
            for number in (seam, seam + 1):
                _add(divided.setdefault(number, []), Place(there[seam].t, float(x), float(y)))
    for home, place in zip(homes, places, strict=True):
        if math.isnan(place.x) and all(math.isnan(each.x) for each in divided[home]):
            nearest = min(known, key=lambda each, home=home: abs(each[0] - home))
            met = _handed_over(*nearest, home, layout, follow)
            _add(divided[home], met[home - 1 if nearest[0] < home else home])
    return divided


def _add(places: list[Place], place: Place) -> None:
    """Unless something is known of that frame."""
    if all(each.t != place.t for each in places):
        places.append(place)


def _handed_over(home: int, place: Place, to: int, layout: Windows, follow: Follow) -> dict[int, Place]:
    """Where the models lead a place of window `home` at each seam on the way to window `to`, by the seam's number."""
    met: dict[int, Place] = {}
    step = 1 if to > home else -1
    for number in range(home, to, step):
        seam = number if step > 0 else number - 1
        shared = layout.shared(seam)
        if not len(shared):
            begin = layout.windows[seam + 1].begin
            raise CorrectionError(
                f"the point at ({place.x:g}, {place.y:g}) of frame {place.t} is corrected across the cut at frame "
                f"{begin}, where no track leads; leave that correction out"
            )
        begin = layout.windows[number].begin
        middle = shared[len(shared) // 2]
        x, y = follow(number, place._replace(t=place.t - begin))[middle - begin]
        place = met[seam] = Place(middle, float(x), float(y))
    return met

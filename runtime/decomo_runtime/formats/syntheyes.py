"""SynthEyes: "Tracker 2-D Paths", a line for each point and frame in sight: name, frame, u, v, outcome.

Frames are counted from 0. u and v run from -1, the centre of the first pixel from the left and from the top, to 1, the
centre of the last one. Hidden frames have no line.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from decomo_runtime.formats.about import About
from decomo_runtime.formats.keys import keyed, shown
from decomo_runtime.tracks import Tracks

FIRST_FRAME = 0
_RUNS, _ENABLED, _FOUND, _KEY = 1, 2, 4, 8
"""Bits of an outcome. A key begins each stretch in sight: solvers weigh keys more, so that not every frame is one."""


def write(tracks: Tracks, path: Path, about: About) -> None:
    """Raises `TracksFileError` where the clip's size is not known, or no point is in sight."""
    points = keyed(tracks, about, FIRST_FRAME)
    last = np.maximum([about.width - 1, about.height - 1], 1)
    with open(path, "w", encoding="ascii", newline="\n") as file:
        for point in shown(points):
            outcomes = (_RUNS | _ENABLED | _FOUND) + _KEY * point.starts()
            for frame, (u, v), outcome in zip(point.numbers, 2 * point.xy / last - 1, outcomes, strict=True):
                file.write(f"{point.name} {frame} {u:.9f} {v:.9f} {outcome}\n")

"""3DEqualizer 4: 2D tracks as its own script for ASCII files exports and imports them.

The number of points; of each its name, its colour, the number of its keys, and a line for each: frame, x, y. Frames are
counted from 1, y is up, and the first pixel's centre is at (0.5, 0.5). Hidden frames have no line.
"""

from __future__ import annotations

from pathlib import Path

from decomo_runtime.formats.about import About
from decomo_runtime.formats.keys import from_bottom_left, keyed, shown
from decomo_runtime.tracks import Tracks

FIRST_FRAME = 1
_RED = 0


def write(tracks: Tracks, path: Path, about: About) -> None:
    """Raises `TracksFileError` where the clip's size is not known, or no point is in sight."""
    points = keyed(tracks, about, FIRST_FRAME)
    with open(path, "w", encoding="ascii", newline="\n") as file:
        file.write(f"{len(points)}\n")
        for point in shown(points):
            file.write(f"{point.name}\n{_RED}\n{len(point.numbers)}\n")
            for frame, (x, y) in zip(point.numbers, from_bottom_left(point.xy, about.height), strict=True):
                file.write(f"{frame} {x:.6f} {y:.6f}\n")

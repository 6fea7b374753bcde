"""MOT Challenge: a line for each object and frame, with its box; here the box of all points, which are one object.

Columns are those of MOT16's ground truth: frame, id, left, top, width, height, whether it counts, class, visibility.
Frames, ids and pixels count from 1: the box of the first pixel alone is 1, 1, 1, 1. A box holds hidden points too, as
MOT's hold hidden parts; visibility is the share of points in sight.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from decomo_runtime.formats.about import About
from decomo_runtime.formats.frames import in_order
from decomo_runtime.tracks import Tracks

FIRST_FRAME = 1
_OBJECT, _COUNTS, _CLASS = 1, 1, 1


def write(tracks: Tracks, path: Path, about: About) -> None:
    """A frame in which no point has a place has no line."""
    tracks = in_order(tracks)
    placed = np.asarray(np.isfinite(tracks.xy).all(axis=-1))
    visibility = 1 - tracks.occluded.mean(axis=0)
    with open(path, "w", encoding="ascii", newline="\n") as file:
        for column, number in enumerate(about.numbers(tracks.frames, FIRST_FRAME).tolist()):
            xy = tracks.xy[placed[:, column], column].astype(np.float64)
            if len(xy):
                left, top = xy.min(axis=0)
                width, height = xy.max(axis=0) - (left, top) + 1
                box = f"{left + 1:.2f},{top + 1:.2f},{width:.2f},{height:.2f}"
                file.write(f"{number},{_OBJECT},{box},{_COUNTS},{_CLASS},{visibility[column]:.4f}\n")

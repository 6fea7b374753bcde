"""MOT Challenge: a line for each object and frame, with the box of its points (`objects.py`).

Columns are those of MOT16's ground truth: frame, id, left, top, width, height, whether it counts, class, visibility.
Frames, ids and pixels count from 1: the box of the first pixel alone is 1, 1, 1, 1. A box holds hidden points too, as
MOT's hold hidden parts; visibility is the share of points in sight.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from decomo_runtime.formats.about import About
from decomo_runtime.formats.frames import in_order
from decomo_runtime.formats.objects import objects_of
from decomo_runtime.tracks import Tracks

FIRST_FRAME = 1
_COUNTS, _CLASS = 1, 1


def write(tracks: Tracks, path: Path, about: About) -> None:
    """Where no point of an object has a place, there is no line."""
    tracks = in_order(tracks)
    rows = [row[row >= 0] for row in objects_of(about, len(tracks.xy)).rows]
    placed = np.asarray(np.isfinite(tracks.xy).all(axis=-1))
    with open(path, "w", encoding="ascii", newline="\n") as file:
        for column, number in enumerate(about.numbers(tracks.frames, FIRST_FRAME).tolist()):
            for owner, points in enumerate(rows, 1):
                xy = tracks.xy[points[placed[points, column]], column].astype(np.float64)
                if len(xy):
                    left, top = xy.min(axis=0)
                    width, height = xy.max(axis=0) - (left, top) + 1
                    box = f"{left + 1:.2f},{top + 1:.2f},{width:.2f},{height:.2f}"
                    visibility = 1 - tracks.occluded[points, column].mean()
                    file.write(f"{number},{owner},{box},{_COUNTS},{_CLASS},{visibility:.4f}\n")

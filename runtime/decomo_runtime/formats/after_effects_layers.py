"""After Effects: a file of keyframe data for each point, to be pasted onto a layer each.

The layer's position follows the point, with a key in each frame in sight, and its opacity is 100 there and 0 where the
point is hidden. Coordinates and frames are those of `after_effects.py`.
"""

from __future__ import annotations

from pathlib import Path

from decomo_runtime.formats import after_effects
from decomo_runtime.formats.about import About
from decomo_runtime.formats.keys import from_top_left, keyed, shown
from decomo_runtime.tracks import Tracks


def write(tracks: Tracks, path: Path, about: About) -> None:
    """`<point>.txt` in the folder `path`; raises what `after_effects.write` does."""
    for point in shown(keyed(tracks, about, after_effects.FIRST_FRAME)):
        with open(path / f"{point.name}.txt", "w", encoding="ascii", newline="\n") as file:
            after_effects.begin(file, about)
            file.write("Transform\tPosition\n\tFrame\tX pixels\tY pixels\tZ pixels\t\n")
            for frame, (x, y) in zip(point.numbers, from_top_left(point.xy), strict=True):
                file.write(f"\t{frame}\t{x:.4f}\t{y:.4f}\t0\t\n")
            file.write("\nTransform\tOpacity\n\tFrame\tpercent\t\n")
            for frame, seen in zip(point.all_numbers, point.seen(), strict=True):
                file.write(f"\t{frame}\t{100 * seen}\t\n")
            file.write("\n")
            after_effects.end(file)

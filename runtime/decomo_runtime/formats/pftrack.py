"""PFTrack: 2D tracks as its track nodes export and import them as text.

Of each point its name in quotes, the number of the clip, the number of its keys, and a line for each: frame, x, y,
similarity, which is the likelihood of the place. Frames are counted from 1, y is up, and the first pixel's centre, at
the bottom left, is at (0, 0). Hidden frames have no line.
"""

from __future__ import annotations

from pathlib import Path

from decomo_runtime.formats.about import About
from decomo_runtime.formats.keys import keyed, shown
from decomo_runtime.tracks import Tracks

FIRST_FRAME = 1
_HEADER = '# "Name"\n# clipNumber\n# frameCount\n# frame, xpos, ypos, similarity\n'
_CLIP = 1


def write(tracks: Tracks, path: Path, about: About) -> None:
    """Raises `TracksFileError` where the clip's size is not known, or no point is in sight."""
    points = keyed(tracks, about, FIRST_FRAME)
    top = about.height - 1
    with open(path, "w", encoding="ascii", newline="\n") as file:
        file.write(_HEADER)
        for point in shown(points):
            file.write(f'\n"{point.name}"\n{_CLIP}\n{len(point.numbers)}\n')
            for frame, (x, y), similarity in zip(point.numbers, point.xy, point.likelihood, strict=True):
                file.write(f"{frame} {x:.6f} {top - y:.6f} {similarity:.6f}\n")

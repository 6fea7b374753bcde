"""After Effects: keyframe data of its clipboard, a Point Control for each point, to be pasted onto one layer.

Its frames begin at 0, y is down, and the first pixel's centre is at (0.5, 0.5). There is a key in each frame in sight;
in between After Effects interpolates.
"""

from __future__ import annotations

from pathlib import Path
from typing import TextIO

from decomo_runtime.formats.about import About
from decomo_runtime.formats.keys import from_top_left, keyed, shown
from decomo_runtime.tracks import Tracks

FIRST_FRAME = 0


def write(tracks: Tracks, path: Path, about: About) -> None:
    """Raises `TracksFileError` where the clip's size or rate is not known, or no point is in sight."""
    points = keyed(tracks, about, FIRST_FRAME)
    with open(path, "w", encoding="ascii", newline="\n") as file:
        begin(file, about)
        for number, point in enumerate(shown(points), 1):
            file.write(f"Effects\tADBE Point Control #{number}\tADBE Point Control-0001\n")
            file.write("\tFrame\tX pixels\tY pixels\t\n")
            for frame, (x, y) in zip(point.numbers, from_top_left(point.xy), strict=True):
                file.write(f"\t{frame}\t{x:.4f}\t{y:.4f}\t\n")
            file.write("\n")
        end(file)


def begin(file: TextIO, about: About) -> None:
    """What is known of the clip, which After Effects calls the source."""
    file.write(
        f"Adobe After Effects 8.0 Keyframe Data\n\n"
        f"\tUnits Per Second\t{about.rate:.6g}\n"
        f"\tSource Width\t{about.width}\n"
        f"\tSource Height\t{about.height}\n"
        f"\tSource Pixel Aspect Ratio\t{about.pixel_aspect:.6g}\n"
        f"\tComp Pixel Aspect Ratio\t{about.pixel_aspect:.6g}\n\n"
    )


def end(file: TextIO) -> None:
    """The last line, by which After Effects knows its own."""
    file.write("\nEnd of Keyframe Data\n")

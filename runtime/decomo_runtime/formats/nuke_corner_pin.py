"""Nuke: four tracks as a CornerPin2D node, which puts a picture of the clip's size onto their quadrangle.

Coordinates and frames are those of `nuke.py`. A corner has a key in each frame in which it is in sight; in which others
Nuke interpolates, or holds, its place stands on the node as its label.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from decomo_runtime.errors import TracksFileError
from decomo_runtime.formats.about import About
from decomo_runtime.formats.keys import Keys, from_bottom_left, keyed
from decomo_runtime.formats.nuke import FIRST_FRAME, HEADER, curve
from decomo_runtime.tracks import Tracks

CORNERS = 4


def check(number: int, _: npt.NDArray[np.int64], __: About) -> None:
    """`TracksFileError` unless there are four points."""
    if number != CORNERS:
        raise TracksFileError(f"a CornerPin2D is made of 4 points, the corners, but there are {number}")


def write(tracks: Tracks, path: Path, about: About) -> None:
    """Raises `TracksFileError` unless the four points are once all in sight, as a convex quadrangle."""
    corners = _in_order(keyed(tracks, about, FIRST_FRAME), about.height)
    width, height = about.width, about.height
    with open(path, "w", encoding="ascii", newline="\n") as file:
        file.write(HEADER + "CornerPin2D {\n")
        for number, corner in enumerate(corners, 1):
            xy = from_bottom_left(corner.xy, about.height)
            file.write(f" to{number} {{{curve(corner, xy[:, 0])} {curve(corner, xy[:, 1])}}}\n")
        for number, (x, y) in enumerate(((0, 0), (width, 0), (width, height), (0, height)), 1):
            file.write(f" from{number} {{{x} {y}}}\n")
        file.write(f' invert false\n label "{_interpolated(corners)}"\n name CornerPin2D_decomotion\n}}\n')


def _in_order(points: list[Keys], height: int) -> list[Keys]:
    """Bottom left, bottom right, top right, top left: as they lie in the first frame in which all are in sight."""
    together = set.intersection(*(set(point.numbers.tolist()) for point in points))
    if len(points) < CORNERS or not together:
        raise TracksFileError("a CornerPin2D needs a frame in which all 4 points are in sight; these have none")
    frame = min(together)
    places = np.stack([from_bottom_left(point.xy[point.numbers == frame], height)[0] for point in points])
    around = places - places.mean(axis=0)
    order = np.argsort(np.arctan2(around[:, 1], around[:, 0]))  # against the clock, as y is up
    order = np.roll(order, -int(places[order].sum(axis=1).argmin()))
    sides = np.roll(places[order], -1, axis=0) - places[order]
    following = np.roll(sides, -1, axis=0)
    if (sides[:, 0] * following[:, 1] - sides[:, 1] * following[:, 0] <= 0).any():
        raise TracksFileError(
            f"a CornerPin2D is made of 4 corners, but in frame {frame} of Nuke one of the points lies within the "
            f"triangle of the others, or on its border"
        )
    return [points[number] for number in order.tolist()]


def _interpolated(corners: list[Keys]) -> str:
    """Which corners have no key in which frames, such as `to2 without key: 3-5 9`; a line for each."""
    lines = []
    for number, corner in enumerate(corners, 1):
        hidden = corner.all_numbers[~corner.seen()]
        runs = np.split(hidden, np.flatnonzero(np.diff(hidden) != 1) + 1)
        if len(hidden):
            spans = " ".join(f"{run[0]}-{run[-1]}" if len(run) > 1 else f"{run[0]}" for run in runs)
            lines.append(f"to{number} without key: {spans}")
    return "\\n".join(lines)

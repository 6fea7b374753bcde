"""Nuke: tracks as one Tracker4 node, to be pasted into the node graph or inserted as a script.

Nuke's frames begin at 1, y is up, and the first pixel's centre is at (0.5, 0.5). Curves have a key in each frame in
sight; elsewhere the track is switched off by its animated `enable`, and Nuke interpolates.
"""

from __future__ import annotations

from pathlib import Path

from decomo_runtime.formats.about import About
from decomo_runtime.formats.keys import Keys, Places, from_bottom_left, keyed, shown
from decomo_runtime.tracks import Tracks

FIRST_FRAME = 1
HEADER = "set cut_paste_input [stack 0]\nversion 12.0 v1\npush $cut_paste_input\n"
_COLUMNS = (
    "5 1 20 enable e 1",
    "3 1 75 name name 1",
    "2 1 58 track_x track_x 1",
    "2 1 58 track_y track_y 1",
    "2 1 63 offset_x offset_x 1",
    "2 1 63 offset_y offset_y 1",
    "4 1 27 T T 1",
    "4 1 27 R R 1",
    "4 1 27 S S 1",
    "2 0 45 error error 1",
    *(f"1 1 0 {name} {name} 1" for name in ("error_min", "error_max")),
    *(f"1 1 0 {area}_{side} {area}_{side} 1" for area in ("pattern", "search") for side in "xyrt"),
    "2 1 0 key_track key_track 1",
    *(f"2 1 0 {area}_{side} {area}_{side} 1" for area in ("key_search", "key_track") for side in "xyrt"),
    *(f"2 1 0 {name} {name} 1" for name in ("key_centre_offset_x", "key_centre_offset_y")),
)
"""Of the table that a Tracker4 is: kind, flags and width of each column, its name and its label."""
_MOVES, _TURNS, _SCALES = 1, 0, 0
"""T, R and S: a new track of Nuke's takes part in the translation alone."""
_PATTERN, _SEARCH = "-32 -32 32 32", "-22 -22 22 22"
"""Of a new track: a box of 64 pixels, and how far it is sought beyond that."""
_NO_KEYFRAMES = "{} " * 11


def write(tracks: Tracks, path: Path, about: About) -> None:
    """Raises `TracksFileError` where the clip's size is not known, or no point is in sight."""
    points = keyed(tracks, about, FIRST_FRAME)
    with open(path, "w", encoding="ascii", newline="\n") as file:
        file.write(HEADER)
        file.write(f"Tracker4 {{\n tracks {{ {{ 1 {len(_COLUMNS)} {len(points)} }}\n{{")
        file.writelines(f" {{ {column} }}\n" for column in _COLUMNS)
        file.write("}\n{\n")
        file.writelines(_row(point, from_bottom_left(point.xy, about.height)) for point in shown(points))
        file.write(f"}}\n}}\n reference_frame {points[0].all_numbers[0]}\n name Tracker_decomotion\n}}\n")


def curve(point: Keys, values: Places) -> str:
    """A value of each key of `point`, every one with its frame, as after a gap Nuke would not count on by one."""
    return "{curve " + " ".join(f"x{n} {value:.4f}" for n, value in zip(point.numbers, values, strict=True)) + "}"


def _row(point: Keys, xy: Places) -> str:
    begin = f"x{point.numbers[0]}"
    still = f"{{curve K {begin} 0}}"
    return (
        f' {{ {_switch(point)} "{point.name}" {curve(point, xy[:, 0])} {curve(point, xy[:, 1])} {still} {still} '
        f"{_MOVES} {_TURNS} {_SCALES} {{curve {begin} 0}} 0 0 {_PATTERN} {_SEARCH} {_NO_KEYFRAMES}}}\n"
    )


def _switch(point: Keys) -> str:
    """Steps from 1, in sight, to 0: Nuke holds the first key before it and the last one behind it."""
    keys, on = [], None
    for number, seen in zip(point.all_numbers.tolist(), point.seen().tolist(), strict=True):
        if seen != on:
            keys.append(f"x{number} {int(seen)}")
            on = seen
    if on:
        keys.append(f"x{int(point.all_numbers[-1]) + 1} 0")
    return "{curve K " + " ".join(keys) + "}"

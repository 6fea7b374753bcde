"""Blender: a script for its Python that builds the tracks in a movie clip.

Blender counts a clip's frames from 1, `frame_start` says where in the scene that is. Positions are in shares of the
frame from its bottom left corner, edge to edge. Where a point is hidden there is a muted marker: no track until the
next key. A track's weight, by which a solved camera goes, is the mean likelihood of its places.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from decomo_runtime.errors import TracksFileError
from decomo_runtime.formats.about import About
from decomo_runtime.formats.keys import Keys, from_bottom_left, keyed, plain_names, shown
from decomo_runtime.tracks import Tracks
from decomotion.frame_files import frame_files

FIRST_FRAME = 1
LONGEST_NAME = 63
LAST_FRAME = 1048574
_SCRIPT = '''\
"""Tracks for Blender: run this in its Text Editor, or as `blender --python FILE`.

They are built in the movie clip CLIP or, where that is None, in the only clip of SIZE that is open. A track of the same
name is replaced.
"""

import bpy

CLIP = {clip!r}
SIZE = ({width}, {height})  # pixels
FRAME_START = {frame_start}  # of the scene, where the clip begins
PIXEL_ASPECT = {pixel_aspect!r}
TRACKS = [  # name, weight, markers (frame of the clip, x, y), frames from which on the point is hidden
{tracks}]


def movie_clip():
    if CLIP is not None:
        found = [bpy.data.movieclips.load(CLIP, check_existing=True)]
    else:
        found = list(bpy.data.movieclips)
    found = [clip for clip in found if tuple(clip.size) == SIZE]
    if len(found) != 1:
        raise RuntimeError("open one clip of %d x %d in the Movie Clip Editor, then run this again" % SIZE)
    return found[0]


def build(clip):
    clip.frame_start = FRAME_START
    clip.tracking.camera.pixel_aspect = PIXEL_ASPECT
    tracks = clip.tracking.tracks
    for name, weight, markers, hidden in TRACKS:
        track = tracks.get(name) or tracks.new(name=name, frame=markers[0][0])
        track.weight = weight
        for frame, x, y in markers:
            track.markers.insert_frame(frame, co=(x, y)).mute = False
        places = {{frame: (x, y) for frame, x, y in markers}}
        for frame in hidden:
            near = min(places, key=lambda known: abs(known - frame))
            track.markers.insert_frame(frame, co=places[near]).mute = True
        kept = places.keys() | set(hidden)
        for frame in [marker.frame for marker in track.markers if marker.frame not in kept]:
            track.markers.delete_frame(frame)


build(movie_clip())
'''


def check(number: int, frames: npt.NDArray[np.int64], about: About) -> None:
    """`TracksFileError` where a limit of Blender's is passed: 63 characters for a name, frame 1,048,574."""
    for name in plain_names(about.names(number)):
        if len(name) > LONGEST_NAME:
            raise TracksFileError(f"Blender's names have up to {LONGEST_NAME} characters; shorten {name}")
    last = frames.max(initial=0) + FIRST_FRAME
    if last >= LAST_FRAME:
        raise TracksFileError(f"Blender counts up to frame {LAST_FRAME} but the tracks reach {last}; give fewer frames")


def write(tracks: Tracks, path: Path, about: About) -> None:
    """Raises `TracksFileError` where the clip's size is not known, or no point is in sight."""
    points = keyed(tracks, replace(about, first_frame=None), FIRST_FRAME)
    script = _SCRIPT.format(
        clip=_file(about.clip),
        width=about.width,
        height=about.height,
        frame_start=FIRST_FRAME if about.first_frame is None else about.first_frame,
        pixel_aspect=float(about.pixel_aspect),
        tracks="".join(_line(point, about) for point in shown(points)),
    )
    path.write_text(script, encoding="utf-8", newline="\n")


def _line(point: Keys, about: About) -> str:
    shares = from_bottom_left(point.xy, about.height) / (about.width, about.height)
    markers = ", ".join(f"({n}, {x:.9f}, {y:.9f})" for n, (x, y) in zip(point.numbers, shares, strict=True))
    return f'    ("{point.name}", {point.likelihood.mean():.4f}, [{markers}], {_hidden_from(point)}),\n'


def _hidden_from(point: Keys) -> list[int]:
    """Frames next to the stretches in sight, which Blender's own tracking mutes: before the first, and behind each."""
    numbers = set(point.numbers.tolist())
    return sorted(({min(numbers) - 1} - {FIRST_FRAME - 1}) | ({number + 1 for number in numbers} - numbers))


def _file(clip: Path | None) -> str | None:
    """A video, or of a folder its first frame, from which Blender finds the others; None where there is none."""
    if clip is None or not clip.exists():
        return None
    return str((frame_files(clip)[0] if clip.is_dir() else clip).absolute())

"""SLEAP: the points of an object as nodes of a skeleton, an instance for each object and frame, as predictions.

Pixel centres are at whole numbers, frames count from 0. A point's score is its likelihood, an instance's their mean; a
hidden point is not visible, and its place is kept.
"""

from __future__ import annotations

import json
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from decomo_runtime.errors import TracksFileError
from decomo_runtime.formats.about import About
from decomo_runtime.formats.frames import clip_files, in_order, likelihood
from decomo_runtime.formats.keys import shown
from decomo_runtime.formats.objects import objects_of
from decomo_runtime.tracks import Tracks
from decomotion.clip import clip_part
from decomotion.files import check_room

_LONGEST = 60_000
"""Bytes of all nodes, a little less than HDF5's limit of an attribute."""
_ROOM = 2**20
"""Bytes of a file beside its points."""


def check(number: int, _: npt.NDArray[np.int64], about: About) -> None:
    """`TracksFileError` where there are more points than a skeleton names."""
    import_module("sleap_io")
    names = objects_of(about, number).parts
    if len(json.dumps([{"name": name, "weight": 1.0, "id": number} for number, name in enumerate(names)])) > _LONGEST:
        raise TracksFileError(f"a skeleton of SLEAP cannot have {len(names)} nodes; follow fewer points")


def write(tracks: Tracks, path: Path, about: About) -> None:
    """Raises `TracksFileError` where there is nothing to write."""
    sio = import_module("sleap_io")
    tracks = in_order(tracks)
    objects = objects_of(about, len(tracks.xy))
    skeleton = sio.Skeleton(nodes=objects.parts, name=about.name)
    owners = [sio.Track(name) for name in objects.names]
    video, numbers = _video(sio, tracks, about), (tracks.frames + _frames_before(about)).tolist()
    scores = likelihood(tracks, about)
    score, of_object = objects.arranged(scores, 0), objects.mean(scores)
    xy, visible = objects.arranged(tracks.xy, np.nan), objects.arranged(~tracks.occluded, False)
    frames = []
    for column, number in shown(list(enumerate(numbers)), "frames"):
        instances = [
            sio.PredictedInstance.from_numpy(
                np.column_stack([xy[row, :, column], score[row, :, column], visible[row, :, column]]),
                skeleton=skeleton,
                track=owner,
                score=float(of_object[row, column]),
            )
            for row, owner in enumerate(owners)
        ]
        frames.append(sio.LabeledFrame(video=video, frame_idx=number, instances=instances))
    check_room(path, _ROOM + 2 * _LONGEST + 64 * score.size + 512 * len(frames) * len(owners))
    labels = sio.Labels(frames, videos=[video], skeletons=[skeleton], tracks=owners)
    sio.save_slp(labels, str(path), embed=False, verbose=False)


def _video(sio: Any, tracks: Tracks, about: About) -> Any:
    """Not opened: it may be elsewhere, and SLEAP asks for it."""
    files = [] if about.clip is None else [str(file) for file in clip_files(about.clip)]
    name = about.name if about.clip is None else str(clip_part(about.clip)[0])
    length = _frames_before(about) + (about.length or int(tracks.frames[-1]) + 1)
    known: dict[str, Any] = {"grayscale": False, "fps": about.fps}
    if about.size is not None:
        known["shape"] = [length, *about.size, 3]
    if files:
        known |= {"type": "ImageVideo", "filename": files[0], "filenames": files}
    return sio.Video(filename=files or name, backend=None, backend_metadata=known, open_backend=False)


def _frames_before(about: About) -> int:
    """Of the video, before the clip, which may be a part of it."""
    if about.first_frame is not None:
        return about.first_frame
    return 0 if about.clip is None or clip_files(about.clip) else clip_part(about.clip)[1]

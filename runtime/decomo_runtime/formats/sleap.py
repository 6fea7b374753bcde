"""SLEAP: the points as nodes of one skeleton, an instance in each frame, as predictions.

Pixel centres are at whole numbers, frames count from 0. A point's score is how surely it is in sight; a hidden one is
not visible, and its place is kept.
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
from decomo_runtime.formats.frames import clip_files, in_order, scores, unique_names
from decomo_runtime.tracks import Tracks
from decomotion.clip import clip_part

_LONGEST = 60_000
"""Bytes of all nodes, a little less than HDF5's limit of an attribute."""


def check(number: int, _: npt.NDArray[np.int64], about: About) -> None:
    """`TracksFileError` where there are more points than a skeleton names."""
    import_module("sleap_io")
    names = unique_names(about.names(number))
    if len(json.dumps([{"name": name, "weight": 1.0, "id": number} for number, name in enumerate(names)])) > _LONGEST:
        raise TracksFileError(f"a skeleton of SLEAP cannot have {len(names)} nodes; follow fewer points")


def write(tracks: Tracks, path: Path, about: About) -> None:
    """Raises `TracksFileError` where there is nothing to write."""
    sio = import_module("sleap_io")
    tracks = in_order(tracks)
    skeleton = sio.Skeleton(nodes=unique_names(about.names(len(tracks.xy))), name=about.name)
    track = sio.Track(about.name)
    video, numbers = _video(sio, tracks, about), (tracks.frames + _frames_before(about)).tolist()
    score = scores(tracks)
    frames = []
    for column, number in enumerate(numbers):
        values = np.column_stack([tracks.xy[:, column], score[:, column], ~tracks.occluded[:, column]])
        instance = sio.PredictedInstance.from_numpy(
            values, skeleton=skeleton, track=track, score=float(score[:, column].mean())
        )
        frames.append(sio.LabeledFrame(video=video, frame_idx=number, instances=[instance]))
    labels = sio.Labels(frames, videos=[video], skeletons=[skeleton], tracks=[track])
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

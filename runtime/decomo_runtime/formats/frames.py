"""Tracks as tools take them that go frame by frame, and the names of their images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from decomo_runtime.errors import TracksFileError
from decomo_runtime.expected_error import chance_near
from decomo_runtime.formats.about import About
from decomo_runtime.tracks import Tracks
from decomotion.clip import clip_part
from decomotion.frame_files import frame_files


def in_order(tracks: Tracks) -> Tracks:
    """The tracks with each frame once, rising.

    Raises `TracksFileError` where there are no points or no frames, or a point in sight has no finite place.
    """
    if not tracks.occluded.size:
        raise TracksFileError("there are no points or no frames, so that there is nothing to write")
    frames, columns = np.unique(tracks.frames, return_index=True)
    of_columns = {name: getattr(tracks, name)[:, columns] for name in ("xy", "occluded", "occlusion")}
    lost = ~np.isfinite(of_columns["xy"]).all(axis=-1) & ~of_columns["occluded"]
    if lost.any():
        point = int(lost.any(axis=1).argmax())
        raise TracksFileError(f"point {point} (counted from 0) is in sight at no finite place; mend the tracks")
    return replace(
        tracks,
        **of_columns,
        frames=frames,
        times=None if tracks.times is None else tracks.times[columns],
        refined=None if tracks.refined is None else tracks.refined[:, columns],
        error=None if tracks.error is None else tracks.error[:, columns],
    )


def in_frame(tracks: Tracks, about: About) -> npt.NDArray[np.bool_]:
    """[N, M], whether the point is within the frame, in sight or not. `TracksFileError` where no size is known."""
    x, y = np.moveaxis(tracks.xy, -1, 0)
    return (x >= -0.5) & (x <= about.width - 0.5) & (y >= -0.5) & (y <= about.height - 0.5)


def likelihood(tracks: Tracks, about: About) -> npt.NDArray[np.float64]:
    """[N, M], how surely a point is in sight where it is told to be, from 0 to 1: the rule of all formats that ask.

    1 - occlusion, times the chance that the place is near the truth (`expected_error.py`) where the tracks say how far
    off it may be; then `TracksFileError` where the clip's size is not known.
    """
    in_sight = 1.0 - np.clip(np.nan_to_num(tracks.occlusion.astype(np.float64), nan=1.0), 0, 1)
    return in_sight if tracks.error is None else in_sight * chance_near(tracks.error, about.height, about.width)


def image_names(about: About, frames: npt.NDArray[np.int64]) -> list[str]:
    """The file name of each frame's image.

    In the clip's folder its own; of a video what `ffmpeg -i clip.mp4 -fps_mode passthrough %05d.png` calls it. Raises
    `TracksFileError` where the folder has no such frame.
    """
    files = () if about.clip is None else clip_files(about.clip)
    if not files:
        return [f"{number:05}.png" for number in about.numbers(frames, 1).tolist()]
    beyond = [frame for frame in frames.tolist() if not 0 <= frame < len(files)]
    if beyond:
        raise TracksFileError(f"{about.clip} has frames 0 to {len(files) - 1}, but there are tracks in {beyond[0]}")
    return [files[frame].name for frame in frames.tolist()]


def clip_files(clip: Path) -> Sequence[Path]:
    """The files of a clip's frames, in order; none of a video. Raises `ClipError` where a folder has none."""
    path, begin, end = clip_part(clip)
    return frame_files(path)[begin:end] if path.is_dir() else ()


def unique_names(names: Sequence[str]) -> list[str]:
    """The names, of which equal ones get a number, whatever their case."""
    used: set[str] = set()
    unique = []
    for name in names:
        wanted, number = name, 2
        while wanted.lower() in used:
            wanted, number = f"{name}_{number}", number + 1
        used.add(wanted.lower())
        unique.append(wanted)
    return unique

"""Your own videos: a folder of `<video>.npz` with tracks, each beside the folder `<video>` of its frames."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from decomo_eval.errors import DatasetError
from decomo_eval.readers.files import Videos, by_suffix, frame_folder
from decomo_eval.video import Video, made_video, numbers
from decomotion.arrays import read_npz

LAYOUT = "a folder of <video>.npz beside folders of frames"


def holds(path: Path) -> bool:
    """Whether this is a folder of .npz files."""
    return bool(by_suffix(path, ".npz"))


def read(path: Path) -> Mapping[str, Video]:
    """The videos by the names of their files.

    `tracks` [N, T, 2] are (x, y) in pixels of the frames, pixel centres at integers, `occluded` is [N, T]; other keys
    are not read.
    """
    return Videos({file.stem: file for file in by_suffix(path, ".npz")}, _read_video)


def _read_video(name: str, file: Path) -> Video:
    folder = file.with_suffix("")
    truth = read_npz(file, DatasetError, ("tracks", "occluded"))
    if not folder.is_dir() or "tracks" not in truth or "occluded" not in truth:
        raise DatasetError(f"{file} must hold tracks and occluded, and {folder} the video's frames")
    frames = frame_folder(folder)
    where = f"video {name} of {file}"
    tracks = numbers(where, "tracks", truth["tracks"])
    if tracks.ndim != 3 or tracks.shape[2] != 2:
        raise DatasetError(f"{file} must have tracks [N, T, 2], but they are {list(tracks.shape)}")
    return made_video(where, name, frames, (tracks + 0.5) / frames.size, truth["occluded"])

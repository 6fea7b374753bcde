"""Tracks of ours as a file of another tool's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from decomo_runtime.errors import TracksFileError
from decomo_runtime.formats.about import About
from decomo_runtime.formats.registry import format_of, rate_of, read
from decomo_runtime.tracks import Tracks
from decomotion.clip import clip_part, read_clip


def convert(
    tracks: str | Path,
    out: str | Path,
    to: str | None = None,
    *,
    size: tuple[int, int] | None = None,
    fps: float | None = None,
    first_frame: int | None = None,
    clip: str | Path | None = None,
) -> Tracks:
    """Reads the file `tracks` and writes `out` in the format `to`, or in the one that its ending means.

    What a format needs and the file does not say comes from `clip`, frames or a video, or from `size`, (height, width)
    in pixels, and `fps`, frames a second, which are taken before it. `first_frame` is what the tool calls the clip's
    first frame. Returns the tracks. Raises `TracksFileError` where the file is none of ours, or the format does not
    exist or cannot hold them, and `ClipError` where `clip` cannot be read; then `out` is left as it was.
    """
    wanted = format_of(Path(out), to)
    if fps is not None and not 0 < fps < float("inf"):
        raise TracksFileError(f"fps must be a number above 0, got {fps}")
    found, about = read(Path(tracks))
    if clip is not None:
        about = _with_clip(about, Path(clip), rate_of(found))
    about = replace(about, size=size or about.size, fps=fps or about.fps, first_frame=first_frame)
    wanted.write(found, Path(out), about)
    return found


def _with_clip(about: About, path: Path, rate: float | None) -> About:
    clip = read_clip(path)
    rated = not clip_part(path)[0].is_dir()  # a folder of frames is only taken to have one
    return replace(
        about,
        size=(clip.height, clip.width),
        fps=clip.fps if rated else about.fps or rate or clip.fps,
        length=len(clip),
        pixel_aspect=clip.pixel_aspect,
        name=clip.name,
        clip=path,
    )

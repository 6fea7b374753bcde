"""A clip: frames of one size in order, from a folder of images or a video file, read when asked for. No torch.

Frames are RGB. Pixel centres lie at integers, frames are counted from 0 (`docs/conventions.md`).
"""

from __future__ import annotations

import hashlib
import logging
import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt

from decomotion.errors import ClipError
from decomotion.frame_files import frame_files, open_frames
from decomotion.frame_gaps import missing_numbers
from decomotion.frames import AnyFrames, Frames
from decomotion.video import ROUNDING, open_video

log = logging.getLogger(__name__)

DEFAULT_FPS = 24.0


@dataclass(frozen=True, init=False, eq=False)
class Clip:
    """Frames of one video.

    Args:
        name: the folder's or the file's name.
        frames: RGB [T, H, W, 3]; an array uint8, mapped from a file too, or frames that are read when asked for.
        fps: of frames at an even rate; 24 where neither this nor `times` is given.
        times: instead, the seconds of each frame.
        pixel_aspect: width of a pixel over its height.
    """

    name: str
    """The folder's or the file's name."""
    frames: AnyFrames
    """RGB [T, H, W, 3]: those of files are read when asked for, and are not kept."""
    times: npt.NDArray[np.float64]
    """[T], seconds of each frame, from 0, strictly increasing; of a folder: index / 24."""
    pixel_aspect: float
    """Width of a pixel over its height as it is to be shown: 1 where pixels are square."""

    def __init__(
        self,
        name: str,
        frames: AnyFrames,
        fps: float | None = None,
        *,
        times: npt.ArrayLike | None = None,
        pixel_aspect: float = 1.0,
    ) -> None:
        if times is None:
            times = np.arange(len(frames)) / (fps or DEFAULT_FPS)
        elif fps is not None:
            raise TypeError("a clip has either a rate or times, not both")
        times = np.asarray(times, np.float64)
        if times.shape != (len(frames),) or not (np.diff(times) > 0).all() or times[:1].any():
            raise ValueError(f"a clip of {len(frames)} frames has as many increasing times, from 0, but got {times}")
        for field, value in {"name": name, "frames": frames, "times": times, "pixel_aspect": pixel_aspect}.items():
            object.__setattr__(self, field, value)

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def height(self) -> int:
        """Of every frame, in pixels."""
        return self.frames.shape[1]

    @property
    def width(self) -> int:
        """Of every frame, in pixels."""
        return self.frames.shape[2]

    @property
    def fps(self) -> float:
        """Frames a second: the mean over the clip, 24 where there is one frame."""
        return mean_rate(self.times)

    @property
    def variable_rate(self) -> bool:
        """Whether the frames are not evenly spaced: `fps` then does not tell when each is shown."""
        return is_variable(self.times)

    def part(self, begin: int, end: int, name: str) -> Clip:
        """The frames from `begin` up to but without `end`, as a clip of its own, named after this one, from time 0."""
        times = self.times[begin:end] - self.times[begin]
        return Clip(f"{self.name}-{name}", self.frames[begin:end], times=times, pixel_aspect=self.pixel_aspect)

    def digest(self) -> str:
        """The key under which all that is derived from the frames is kept: 16 hexadecimal digits, made once.

        Of an array it is a hash of the pixels, shape included; of frames in files one of the files' bytes and of which
        frames they are. Raises `ClipError` where the files have changed.
        """
        return self._digest

    @cached_property
    def _digest(self) -> str:
        if isinstance(self.frames, Frames):
            return self.frames.digest()
        content = hashlib.sha256(repr(self.frames.shape).encode())
        for frame in self.frames:
            content.update(np.ascontiguousarray(frame).data)
        return content.hexdigest()[:16]


def mean_rate(times: npt.NDArray[np.float64]) -> float:
    """Frames a second of frames at these times [T]: their number over the time they span, 24 of one frame.

    Given to twelve digits, so that frames at i / 24 have 24.
    """
    return float(f"{(len(times) - 1) / (times[-1] - times[0]):.12g}") if len(times) > 1 else DEFAULT_FPS


def is_variable(times: npt.NDArray[np.float64]) -> bool:
    """Whether some frame stands for a time that differs from the usual one by more than a quarter and 1 millisecond.

    Containers round times, many to whole milliseconds: that alone makes no rate variable.
    """
    steps = np.diff(times)
    usual = np.median(steps) if len(steps) else 0.0
    return bool((np.abs(steps - usual) > usual / 4 + ROUNDING).any())


def read_clip(path: str | Path) -> Clip:
    """Opens a folder of frames (`clip/` or OmniMotion's `clip/color/`; jpg or png) or a video file.

    Frames are upright, and read when they are asked for. A video is decoded once here, to count its frames.
    With `@A:B` behind the path, the frames from A up to but without B, a shot of a longer video: what follows is not
    decoded. Says in the log what a damaged video has lost, and where times, pixels or values are not as usual
    (`docs/formats.md`).

    Raises `ClipError` where there are fewer than two frames, frames of different sizes, a file of a folder that does
    not decode as far as its header tells, or files that can be read as two clips or in two orders.
    """
    path, begin, end = clip_part(Path(path))
    if not path.exists():
        raise ClipError(f"{path} does not exist; give a folder of frames or a video file")
    if not path.is_dir() and not path.is_file():
        raise ClipError(f"{path} is a pipe or a device, and a clip is read more than once; give a file, or a folder")
    name = _folder_name(path) if path.is_dir() else path.stem
    if path.is_dir():
        files = frame_files(path)
        if lacking := missing_numbers([file.name for file in files]):
            log.warning("%s %s", name, lacking)
        frames, count, times, pixel_aspect = open_frames(files, begin, end), len(files), None, 1.0
    else:
        video = open_video(path, begin, end)
        frames, count, times, pixel_aspect = video.frames, video.count, video.times, video.pixel_aspect
    if end is not None and count < end:
        raise ClipError(f"{name} has frames 0 to {count - 1}; @{begin}:{end} is not two or more of them")
    if len(frames) < 2:
        raise ClipError(f"{path} has one frame; motion needs at least two")
    name = name if end is None else f"{name}-{begin}-{end}"
    clip = Clip(name, frames, times=times, pixel_aspect=pixel_aspect)
    if clip.pixel_aspect != 1:
        log.info(
            "%s has pixels %.4g times as wide as high; positions are in its own, %dx%d",
            name,
            clip.pixel_aspect,
            clip.width,
            clip.height,
        )
    if clip.variable_rate:
        log.info("%s has frames at uneven times, %.4g a second in the mean", name, clip.fps)
    return clip


def clip_part(path: Path) -> tuple[Path, int, int | None]:
    """The path of a clip without its `@A:B`, the first frame that is wanted of it, and the one after the last.

    None: all. Raises `ClipError` where these are not two or more.
    """
    part = re.fullmatch(r"(.+)@(\d+):(\d+)", str(path))
    if part is None or path.exists():
        return path, 0, None
    begin, end = int(part[2]), int(part[3])
    if end < begin + 2:
        raise ClipError(f"{path}: @{begin}:{end} is not two or more frames; motion needs at least two")
    return Path(part[1]), begin, end


def _folder_name(path: Path) -> str:
    folder = path.resolve()
    own_names = (part.name for part in (folder, *folder.parents) if part.name not in ("color", "clip", "frames"))
    return next(own_names) or folder.name

"""A clip: frames of one size in order, read from a folder of images or from a video file. No torch.

Frames are RGB. Pixel centres lie at integers, frames are counted from 0 (`docs/conventions.md`).
"""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from decomotion.errors import ClipError

IMAGE_SUFFIXES = {".jpg", ".jpeg", ".png"}
DEFAULT_FPS = 24.0


@dataclass(frozen=True)
class Clip:
    """Frames of one video."""

    name: str
    """The folder's or the file's name."""
    frames: npt.NDArray[np.uint8]
    """[T, H, W, 3], RGB."""
    fps: float
    """Frames a second; 24 where the source is a folder."""

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def height(self) -> int:
        return self.frames.shape[1]

    @property
    def width(self) -> int:
        return self.frames.shape[2]

    def digest(self) -> str:
        """Hash of the frames' content, shape included: the key under which all that is derived from them is kept."""
        content = hashlib.sha256(repr(self.frames.shape).encode())
        content.update(np.ascontiguousarray(self.frames).data)
        return content.hexdigest()[:16]


def read_clip(path: str | Path) -> Clip:
    """Reads a folder of frames (`clip/` or OmniMotion's `clip/color/`; jpg or png, natural order) or a video file.

    Raises `ClipError` where there are fewer than two frames, frames of different sizes, or one that does not decode.
    """
    path = Path(path)
    if not path.exists():
        raise ClipError(f"{path} does not exist; give a folder of frames or a video file")
    name, (frames, fps) = (
        (_folder_name(path), (_read_folder(path), DEFAULT_FPS)) if path.is_dir() else (path.stem, _read_video(path))
    )
    if len(frames) < 2:
        raise ClipError(f"{path} has one frame; motion needs at least two")
    return Clip(name, np.stack(frames), fps)


def _folder_name(path: Path) -> str:
    folder = path.resolve()
    generic = folder.name in ("color", "clip", "frames")
    return folder.parent.name if generic and folder.parent.name else folder.name


def _natural(path: Path) -> list[tuple[int, int | str]]:
    return [(0, int(part)) if part.isdigit() else (1, part) for part in re.split(r"(\d+)", path.name)]


def _images_in(folder: Path) -> list[Path]:
    return sorted((file for file in folder.iterdir() if file.suffix.lower() in IMAGE_SUFFIXES), key=_natural)


def _read_folder(folder: Path) -> list[npt.NDArray[np.uint8]]:
    files = _images_in(folder)
    if not files and (folder / "color").is_dir():
        files = _images_in(folder / "color")
    if not files:
        raise ClipError(f"{folder} holds no frames; put .jpg or .png files there, or in {folder / 'color'}")
    frames = []
    for file in files:
        frame = cv2.imdecode(np.fromfile(file, np.uint8), cv2.IMREAD_COLOR) if file.stat().st_size else None
        if frame is None:
            raise ClipError(f"frame {file} does not decode as an image; replace it or remove it")
        if frames and frame.shape != frames[0].shape:
            raise ClipError(
                f"frame {file} is {frame.shape[1]}x{frame.shape[0]} but {files[0].name} is "
                f"{frames[0].shape[1]}x{frames[0].shape[0]}; bring all frames to one size"
            )
        frames.append(cv2.cvtColor(frame, cv2.COLOR_BGR2RGB))
    return frames


def _read_video(path: Path) -> tuple[list[npt.NDArray[np.uint8]], float]:
    import av

    try:
        with av.open(str(path)) as container:
            if not container.streams.video:
                raise ClipError(f"{path} has no video stream; give a video file or a folder of frames")
            stream = container.streams.video[0]
            fps = float(stream.average_rate or DEFAULT_FPS)
            frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
    except (av.FFmpegError, OSError) as error:
        raise ClipError(f"{path} does not decode as a video ({error}); give a video file or a folder of frames") from error
    if not frames:
        raise ClipError(f"{path} has a video stream without frames; give another file")
    return frames, fps

"""Clips as files, for tests of what reads them."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import numpy.typing as npt
from av.stream import Disposition

Frames = npt.NDArray[np.uint8]


def flat_frames(levels: Sequence[int], height: int = 16, width: int = 24) -> Frames:
    """One frame for each level, [T, H, W, 3]: the level in red, a left-to-right ramp in green, nothing in blue."""
    frames = np.zeros((len(levels), height, width, 3), np.uint8)
    frames[..., 0] = np.array(levels)[:, None, None]
    frames[..., 1] = np.arange(width) * 200 // width
    return frames


def write_images(folder: Path, names: Sequence[str], frames: Frames) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for name, frame in zip(names, frames, strict=True):
        encoded = cv2.imencode(Path(name).suffix.lower(), cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))[1]
        (folder / name).write_bytes(encoded.tobytes())
    return folder


def turned_jpeg(frame: Frames, orientation: int) -> bytes:
    """A JPEG of the frame [H, W, 3] whose EXIF tells its orientation, 1 to 8."""
    encoded = cv2.imencode(".jpg", cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))[1].tobytes()
    entry = struct.pack(">HHIHH", 0x112, 3, 1, orientation, 0)
    exif = b"Exif\0\0MM\0*" + struct.pack(">IH", 8, 1) + entry + bytes(4)
    return encoded[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + encoded[2:]


def shown_by_exif(frame: Frames, orientation: int) -> Frames:
    """How a viewer shows the frame [H, W, 3] of that orientation."""
    turned = frame.swapaxes(0, 1) if orientation > 4 else frame
    rows = -1 if orientation in (3, 4, 7, 8) else 1
    columns = -1 if orientation in (2, 3, 6, 7) else 1
    return turned[::rows, ::columns]


def write_video(
    path: Path,
    frames: Frames,
    fps: Fraction | int = 12,
    *,
    times: Sequence[int] | None = None,
    time_base: Fraction = Fraction(1, 1000),
    pixel_aspect: Fraction | None = None,
    options: Mapping[str, str] | None = None,
    container: Mapping[str, str] | None = None,
) -> Path:
    """Frames as H.264; with `times`, each has its own, in units of `time_base`; the last two are ffmpeg's options."""
    with av.open(str(path), "w", options=dict(container or {})) as file:
        stream = file.add_stream("libx264", rate=fps, options={"crf": "8", **(options or {})})
        stream.height, stream.width, stream.pix_fmt = frames.shape[1], frames.shape[2], "yuv420p"
        if pixel_aspect is not None:
            stream.codec_context.sample_aspect_ratio = pixel_aspect
        if times is not None:
            stream.codec_context.time_base = time_base
        for number, frame in enumerate(frames):
            picture = av.VideoFrame.from_ndarray(frame, format="rgb24")
            if times is not None:
                picture.pts, picture.time_base = times[number], time_base
            file.mux(stream.encode(picture))
        file.mux(stream.encode())
    return path


def write_jpegs(path: Path, files: Sequence[bytes], size: tuple[int, int], fps: int = 12) -> Path:
    """A video whose frames are these JPEG files of (height, width), as cameras write them."""
    with av.open(str(path), "w") as file:
        stream = file.add_stream("mjpeg", rate=fps)
        (stream.height, stream.width), stream.pix_fmt = size, "yuvj420p"
        for number, content in enumerate(files):
            packet = av.Packet(content)
            packet.stream, packet.time_base, packet.is_keyframe = stream, Fraction(1, fps), True
            packet.pts = packet.dts = number
            file.mux(packet)
    return path


def write_streams(path: Path, streams: Iterable[tuple[str, Frames, bool]]) -> Path:
    """A file of several video streams: the encoder of each, its frames, and whether it is the default one."""
    with av.open(str(path), "w") as file:
        written = []
        for codec, frames, default in streams:
            stream = file.add_stream(codec, rate=12)
            stream.height, stream.width = frames.shape[1:3]
            stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
            stream.disposition = Disposition.default if default else Disposition(0)
            written.append((stream, frames))
        for stream, frames in written:
            for frame in frames:
                file.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
            file.mux(stream.encode())
    return path


def with_display_matrix(path: Path, matrix: tuple[int, int, int, int]) -> Path:
    """Phones write how the stored frames are to be shown into the mp4's track header."""
    content = bytearray(path.read_bytes())
    a, b, c, d = (value << 16 for value in matrix)
    struct.pack_into(">9i", content, content.index(b"tkhd") + 44, a, b, 0, c, d, 0, 0, 0, 1 << 30)
    path.write_bytes(content)
    return path

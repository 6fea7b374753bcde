"""A drifting scene as a video of many codecs and containers, and what is in it."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import cast

import av
import cv2
import numpy as np
import numpy.typing as npt
from av.video.stream import VideoStream

COUNT = 75
GOP = {"g": "12", "keyint_min": "12", "sc_threshold": "0"}
B_FRAMES = GOP | {"bf": "3", "b_strategy": "0"}
OPEN = B_FRAMES | {"x264-params": "open-gop=1:bframes=3:b-adapt=0"}
FORMS: dict[str, tuple[str, str, dict[str, str]]] = {
    "B-frames": ("film.mp4", "libx264", B_FRAMES),
    "no B-frames": ("film.mkv", "libx264", GOP | {"bf": "0"}),
    "open groups": ("film.mp4", "libx264", OPEN),
    "open groups in Matroska": ("film.mkv", "libx264", OPEN),
    "open groups of HEVC": (
        "film.mp4",
        "libx265",
        {"x265-params": "keyint=12:min-keyint=12:open-gop=1:log-level=none"},
    ),
    "no key frame but the first": ("film.mp4", "libx264", {"x264-params": "intra-refresh=1:keyint=12:bframes=0"}),
    "one group": ("film.mp4", "libx264", {"g": "500", "sc_threshold": "0"}),
    "groups of two": ("film.mp4", "libx264", {"g": "2", "bf": "1", "b_strategy": "0", "sc_threshold": "0"}),
    "key frames alone": ("film.mp4", "libx264", {"g": "1"}),
    "AVI with B-frames": ("film.avi", "libx264", B_FRAMES),
    "AVI": ("film.avi", "mpeg4", {"g": "12"}),
    "MJPEG": ("film.avi", "mjpeg", {}),
    "a bare stream": ("film.h264", "libx264", B_FRAMES),
    "a transport stream": ("film.ts", "mpeg2video", {"g": "12", "bf": "2"}),
    "a transport stream of H.264": ("film.ts", "libx264", OPEN),
    "a programme stream": ("film.mpg", "mpeg2video", {"g": "12", "bf": "2"}),
    "VP9 with frames that are not shown": (
        "film.webm",
        "libvpx-vp9",
        {"g": "12", "auto-alt-ref": "1", "lag-in-frames": "12"},
    ),
    "without loss": ("film.mkv", "ffv1", {}),
    "RGB": ("film.avi", "rawvideo", {}),
}
PIXELS = {"mjpeg": "yuvj420p", "rawvideo": "rgb24", "ffv1": "yuv444p10le"}


def drifting(count: int = COUNT, height: int = 60, width: int = 94) -> npt.NDArray[np.uint8]:
    """A scene that drifts, and from the middle on another: [T, H, W, 3]."""
    scenes = [scene(seed, height, width + count) for seed in range(2)]
    return np.stack([scenes[number * 2 // count][:, number : number + width] for number in range(count)])


def scene(seed: int, height: int, width: int) -> npt.NDArray[np.uint8]:
    """Soft shapes of three sizes."""
    chance = np.random.default_rng(seed)
    shapes = sum(
        cv2.resize(chance.normal(0, 30, (*cells, 3)).astype(np.float32), (width, height), interpolation=cv2.INTER_CUBIC)
        for cells in ((4, 10), (9, 24), (20, 54))
    )
    return np.clip(100 + shapes, 0, 255).astype(np.uint8)


def write(
    path: Path, codec: str, options: dict[str, str], times: list[int] | None = None, pixels: str | None = None
) -> Path:
    frames = drifting()
    with av.open(str(path), "w", options={"movflags": "faststart"} if path.suffix == ".mp4" else {}) as file:
        stream = cast(VideoStream, file.add_stream(codec, rate=25, options=options))
        stream.height, stream.width = frames.shape[1:3]
        stream.pix_fmt = pixels or PIXELS.get(codec, "yuv420p")
        if times is not None:
            stream.codec_context.time_base = Fraction(1, 1000)
        for number, frame in enumerate(frames):
            picture = av.VideoFrame.from_ndarray(frame, format="rgb24")
            if times is not None:
                picture.pts, picture.time_base = times[number], Fraction(1, 1000)
            file.mux(stream.encode(picture))
        file.mux(stream.encode())
    return path


def plainly_decoded(path: Path) -> Iterator[npt.NDArray[np.uint8]]:
    with av.open(str(path)) as file:
        for frame in file.decode(video=0):
            yield np.asarray(frame.to_ndarray(format="rgb24"), np.uint8)


def lowest_row_first(folder: Path) -> Path:
    """As old programs write AVI: the height in its header is positive."""
    path = write(folder / "film.avi", "rawvideo", {}, pixels="bgr24")
    upright, content = list(plainly_decoded(path)), bytearray(path.read_bytes())
    place = content.index(b"strf") + 16
    struct.pack_into("<i", content, place, -struct.unpack_from("<i", content, place)[0])
    path.write_bytes(content)
    np.testing.assert_array_equal(next(plainly_decoded(path)), upright[0][::-1])
    return path


def by_a_palette(folder: Path) -> Path:
    """Pictures whose colours stand in a palette, which AVI holds with the first of them and where it changes."""
    frames, path = drifting(), folder / "film.avi"
    with av.open(str(path), "w") as file:
        stream = cast(VideoStream, file.add_stream("rawvideo", rate=25))
        stream.height, stream.width, stream.pix_fmt = *frames.shape[1:3], "pal8"
        for number, frame in enumerate(frames):
            palette = np.full((256, 4), 255, np.uint8)
            palette[:, 1] = np.arange(256)
            palette[:, 2] = 40 if number < COUNT // 3 else 200
            entries = np.ascontiguousarray(frame[..., 0])
            file.mux(stream.encode(av.VideoFrame.from_ndarray((entries, palette), format="pal8")))  # pyright: ignore
        file.mux(stream.encode())
    return path


def grey_and_alpha_exr(height: int, width: int) -> bytes:
    """An OpenEXR file of floats of 32 bits, without compression."""

    def attribute(name: bytes, kind: bytes, value: bytes) -> bytes:
        return name + b"\0" + kind + b"\0" + struct.pack("<I", len(value)) + value

    channels = b"".join(name + b"\0" + struct.pack("<iB3xii", 2, 0, 1, 1) for name in (b"A", b"Y")) + b"\0"
    box = struct.pack("<4i", 0, 0, width - 1, height - 1)
    attributes = (
        attribute(b"channels", b"chlist", channels),
        attribute(b"compression", b"compression", b"\0"),
        attribute(b"dataWindow", b"box2i", box),
        attribute(b"displayWindow", b"box2i", box),
        attribute(b"lineOrder", b"lineOrder", b"\0"),
        attribute(b"pixelAspectRatio", b"float", struct.pack("<f", 1)),
        attribute(b"screenWindowCenter", b"v2f", struct.pack("<2f", 0, 0)),
        attribute(b"screenWindowWidth", b"float", struct.pack("<f", 1)),
    )
    head = struct.pack("<II", 20000630, 2) + b"".join(attributes) + b"\0"
    row = struct.pack(f"<{2 * width}f", *[0.5] * (2 * width))
    lines = [struct.pack("<iI", number, len(row)) + row for number in range(height)]
    first = len(head) + 8 * height
    places = struct.pack(f"<{height}Q", *[first + number * len(lines[0]) for number in range(height)])
    return head + places + b"".join(lines)

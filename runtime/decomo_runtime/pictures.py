"""Writes frames to files: video that browsers or editors play, and png, each whole or not at all.

The suffix of a video chooses its form:

    .mp4    H.264, yuv420p, plays everywhere; no alpha
    .webm   VP9, with alpha for browsers (yuva420p)
    .mov    ProRes 4444, with alpha for editors (yuva444p10le)
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, cast

import cv2
import numpy as np
import numpy.typing as npt

from decomo_runtime.ticks import LARGEST, ticks_of
from decomotion.files import new_folder, replacing
from decomotion.images import png

if TYPE_CHECKING:
    from av.container import OutputContainer
    from av.packet import Packet

Image = npt.NDArray[np.uint8]

VIDEO_SUFFIXES = (".mp4",)
ALPHA_SUFFIXES = (".webm", ".mov")
"""Forms that keep an alpha channel."""

_BT601_MATRIX, _BT709, _MPEG_RANGE = 6, 1, 1
"""FFmpeg's numbers. It converts RGB by BT.601; said in the file, no player has to guess the colours from the size."""


@dataclass(frozen=True)
class _Form:
    """How a video is encoded."""

    container: str
    codec: str
    pixels: str
    pixels_with_alpha: str | None = None
    options: Mapping[str, str] = field(default_factory=dict)
    container_options: Mapping[str, str] = field(default_factory=dict)
    options_unsteady: Mapping[str, str] = field(default_factory=dict)
    """Of the encoder, in addition, where frames are not of one length."""
    tells_aspect: bool = True
    """Whether the file can say that its pixels are not square."""


_FORMS = {
    ".mp4": _Form(
        "mp4",
        "libx264",
        "yuv420p",
        options={"crf": "18", "preset": "medium"},
        container_options={"movflags": "+faststart"},
        options_unsteady={"bf": "0"},  # with B frames the last one's length is lost
    ),
    ".webm": _Form(
        "webm",
        "libvpx-vp9",
        "yuv420p",
        "yuva420p",
        {"crf": "20", "b": "0", "auto-alt-ref": "0", "row-mt": "1", "cpu-used": "3"},  # alpha bars alt-ref frames
        tells_aspect=False,  # PyAV has no way to
    ),
    ".mov": _Form(
        "mov",
        "prores_ks",
        "yuv444p10le",
        "yuva444p10le",
        {"profile": "4444", "vendor": "apl0", "threads": "1"},  # its threads share the buffer of blocks at the border
    ),
}


def write_video(
    path: str | Path,
    frames: Iterable[Image],
    fps: float,
    *,
    times: npt.ArrayLike | None = None,
    pixel_aspect: float = 1.0,
) -> None:
    """Encodes `frames`, one or more of one even size, RGB [H, W, 3], or RGBA [H, W, 4] with alpha not premultiplied.

    Args:
        path: its suffix chooses the form; .mp4 takes no alpha.
        frames: as many as `times`, where these are given.
        fps: frames a second.
        times: [frame], rising: the second at which each is shown; default: `fps` frames a second. The last is shown as
            long as the one before it.
        pixel_aspect: a pixel's width by its height, of which the file tells; .webm is scaled to square pixels instead.

    Raises `OSError`, naming `path`, where the disk is full, `RenderError` where a frame is shown for longer than a file
    can say (`ticks.py`), or there are too many a second.
    """
    import av
    from av.video.stream import VideoStream

    form = _FORMS[Path(path).suffix.lower()]
    if not form.tells_aspect:
        frames, pixel_aspect = map(partial(_square, pixel_aspect=pixel_aspect), frames), 1.0
    frames = iter(frames)
    first = next(frames)
    height, width, channels = first.shape
    pixels = form.pixels if channels == 3 else form.pixels_with_alpha
    assert pixels is not None, f"{path} cannot hold an alpha channel"
    ticks = ticks_of(fps, times)
    options = dict(form.options if ticks.steady else {**form.options, **form.options_unsteady})
    with (
        replacing(Path(path).absolute()) as temporary,  # FFmpeg takes what is before a colon for a protocol, else
        av.open(str(temporary), "w", format=form.container, options=dict(form.container_options)) as container,
    ):
        stream = cast("VideoStream", container.add_stream(form.codec, rate=ticks.rate, options=options))
        stream.width, stream.height, stream.pix_fmt = width, height, pixels
        context = stream.codec_context
        context.time_base = ticks.tick
        context.colorspace, context.color_range = _BT601_MATRIX, _MPEG_RANGE
        context.color_primaries = context.color_trc = _BT709
        if pixel_aspect != 1:
            context.sample_aspect_ratio = Fraction(pixel_aspect).limit_denominator(LARGEST)
        if channels == 4:
            stream.metadata["alpha_mode"] = "1"  # what a webm player looks for
        layout = "rgb24" if channels == 3 else "rgba"
        lengths: dict[int | None, int] = {}
        for frame, (begin, length) in zip(chain([first], frames), ticks.shown, strict=False):
            picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(frame), format=layout)
            picture.pts, picture.time_base, lengths[begin] = begin, ticks.tick, length
            _mux(container, stream.encode(picture), lengths)
        _mux(container, stream.encode(), lengths)


def _mux(container: OutputContainer, packets: Iterable[Packet], lengths: Mapping[int | None, int]) -> None:
    for packet in packets:
        packet.duration = lengths[packet.pts]  # which the encoder does not know
        container.mux(packet)


def _square(frame: Image, pixel_aspect: float) -> Image:
    """The frame, made wider or higher until its pixels are square, and even."""
    if pixel_aspect == 1:
        return frame
    height, width = frame.shape[:2]
    size = (round(width * max(pixel_aspect, 1)), round(height * max(1 / pixel_aspect, 1)))
    return evened(cv2.resize(frame, size, interpolation=cv2.INTER_LINEAR).astype(np.uint8, copy=False))


def write_png(path: str | Path, image: Image) -> None:
    """Writes `image`, RGB [H, W, 3] or RGBA [H, W, 4], as a png."""
    with replacing(path) as temporary:
        temporary.write_bytes(png(image))


def write_sequence(folder: str | Path, images: Iterable[tuple[str, Image]]) -> None:
    """Writes named images as `<name>.png` in `folder`, which appears whole or not at all.

    A name may hold `/` for a folder within. Raises `OSError` where `folder` has something in it.
    """
    with new_folder(folder) as temporary:
        for name, image in images:
            path = temporary / f"{name}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(png(image))


def evened(frame: Image) -> Image:
    """The frame, its last row and column repeated where that makes its size even, as video needs it."""
    height, width = frame.shape[:2]
    if height % 2 == 0 and width % 2 == 0:
        return frame
    return cv2.copyMakeBorder(frame, 0, height % 2, 0, width % 2, cv2.BORDER_REPLICATE).astype(np.uint8, copy=False)


def flattened(image: Image, cell: int = 8) -> Image:
    """RGBA [H, W, 4] laid over grey chequers of `cell` pixels: RGB [H, W, 3]. RGB is returned as it is."""
    if image.shape[2] == 3:
        return image
    row, column = np.indices(image.shape[:2]) // cell
    ground = np.where((row + column) % 2, 204, 153)[..., None].astype(np.float32)
    alpha = image[..., 3:].astype(np.float32) / 255
    return np.rint(ground * (1 - alpha) + image[..., :3] * alpha).astype(np.uint8)


def on_black(image: Image) -> Image:
    """RGBA [H, W, 4] laid over black: RGB [H, W, 3]. RGB is returned as it is."""
    if image.shape[2] == 3:
        return image
    return np.rint(image[..., :3] * (image[..., 3:].astype(np.float32) / 255)).astype(np.uint8)


def tiled(images: Iterable[Image], columns: int) -> Image:
    """RGB images of one size in rows of `columns`, the last row filled up with black."""
    tiles = list(images)
    tiles += [np.zeros_like(tiles[0])] * (-len(tiles) % columns)
    rows = [np.concatenate(tiles[start : start + columns], axis=1) for start in range(0, len(tiles), columns)]
    return np.concatenate(rows)

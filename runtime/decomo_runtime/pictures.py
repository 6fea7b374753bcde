"""Writes frames to files that browsers show: H.264 video and png, each whole or not at all."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from itertools import chain
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from decomotion.files import replacing

Image = npt.NDArray[np.uint8]

VIDEO_SUFFIXES = (".mp4",)
_BT601_MATRIX, _BT709, _MPEG_RANGE = 6, 1, 1
"""FFmpeg's numbers. It converts RGB by BT.601; said in the file, no player has to guess the colours from the size."""


def write_video(path: str | Path, frames: Iterable[Image], fps: float) -> None:
    """Encodes `frames`, one or more of one even size [H, W, 3] RGB, as an mp4 (H.264, yuv420p, index in front)."""
    import av

    frames = iter(frames)
    first = next(frames)
    height, width = first.shape[:2]
    with (
        replacing(path) as temporary,
        av.open(str(temporary), "w", format="mp4", options={"movflags": "+faststart"}) as container,
    ):
        stream = container.add_stream(
            "libx264", rate=Fraction(fps).limit_denominator(1001), options={"crf": "18", "preset": "medium"}
        )
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        context = stream.codec_context
        context.colorspace, context.color_range = _BT601_MATRIX, _MPEG_RANGE
        context.color_primaries = context.color_trc = _BT709
        for frame in chain([first], frames):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(frame), format="rgb24")))
        container.mux(stream.encode())


def write_png(path: str | Path, image: Image) -> None:
    """Writes `image` [H, W, 3] RGB as a png."""
    encoded = cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))[1]
    with replacing(path) as temporary:
        temporary.write_bytes(encoded.tobytes())

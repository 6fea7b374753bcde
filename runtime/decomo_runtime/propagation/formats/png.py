"""Label PNGs: the value of a pixel is its object's number, 0 and what is transparent are none; grey of 8 or 16
bits, or with a palette.

One file is of one frame; a palette is kept.
"""

from __future__ import annotations

import io
from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import cast

import av
import av.error
import cv2
import numpy as np
import numpy.typing as npt

from decomo_runtime.errors import AnnotationError
from decomo_runtime.propagation.formats.asked import ClipFacts, masked
from decomo_runtime.propagation.shapes import Annotation, Shape, Thing
from decomotion.frame_files import where_opaque
from decomotion.images import as_shown, plausible, png

Palette = npt.NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class _Look:
    """How the files are made."""

    palette: Palette | None
    """[256, 4], alpha, red, green, blue."""
    wide: bool
    """Whether values have 16 bits."""


def read(path: Path, content: bytes, frame: int | None, clip: ClipFacts) -> Annotation:
    """The objects of a label PNG; `AnnotationError` where it is none, is of another size or has no object."""
    if frame is None:
        raise AnnotationError(f"{path} does not tell its frame; give {path}@T with the frame's number, counted from 0")
    labels, look = _labels(path, content)
    if labels.shape != clip.size:
        raise AnnotationError(
            f"{path} is {labels.shape[1]}x{labels.shape[0]} but the clip is {clip.size[1]}x{clip.size[0]}; resize it, "
            "without blending labels, or give one that was drawn on this clip"
        )
    ids = [int(value) for value in np.unique(labels) if value]
    if not ids:
        raise AnnotationError(f"{path} is black: no pixel of it is an object's")
    things = tuple(Thing(value, str(value)) for value in ids)
    shapes = tuple(masked(path, number, frame, labels == value, clip) for number, value in enumerate(ids))
    return Annotation(clip.size, things, shapes, look)


def write(folder: Path, annotation: Annotation, frames: Iterable[tuple[int, list[Shape]]], clip: ClipFacts) -> None:
    """A PNG for each frame, as the first that was read: palette and depth are kept."""
    look: _Look = annotation.source
    wide = look.wide or any(int(thing.id) > 255 for thing in annotation.things)
    for frame, shapes in frames:
        labels = np.zeros(annotation.size, np.uint16 if wide else np.uint8)
        for shape in shapes:
            if shape.mask is not None:
                labels[shape.mask] = annotation.things[shape.thing].id
        path = folder / f"{Path(clip.image(frame)).stem}.png"
        path.write_bytes(_encoded(labels, None if wide else look.palette))


def _labels(path: Path, content: bytes) -> tuple[npt.NDArray[np.integer], _Look]:
    if not content.startswith(b"\x89PNG") or not plausible(content):
        raise AnnotationError(f"{path} does not decode as a PNG; give a PNG of labels")
    try:
        if content[25] == 3:  # its colour type: by a palette
            with av.open(io.BytesIO(content), "r", format="png_pipe") as container:
                decoded = next(container.decode(video=0)).to_ndarray()
            labels, palette = cast("tuple[npt.NDArray[np.uint8], Palette]", decoded)
            labels = as_shown(labels, content)
            return np.where(palette[labels, 0] > 0, labels, 0), _Look(palette, False)
        image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    except (cv2.error, av.error.FFmpegError, StopIteration, IndexError) as error:
        raise AnnotationError(f"{path} does not decode as a PNG; give a PNG of labels") from error
    if image is None:
        raise AnnotationError(f"{path} does not decode as a PNG; give a PNG of labels")
    opaque = where_opaque(cast("npt.NDArray[np.uint8]", image), content)
    if opaque is not None:
        image = np.where(opaque if image.ndim == 2 else opaque[..., None], image, 0)
    if image.ndim == 3:
        colours = image[..., :3]
        if (colours != colours[..., :1]).any():
            raise AnnotationError(
                f"{path} has colours without a palette, which do not tell objects' numbers; save it as grey or with a "
                "palette"
            )
        image = colours[..., 0]
    image = as_shown(image, content)
    if image.dtype not in (np.uint8, np.uint16):
        raise AnnotationError(f"{path} has values of {image.dtype}; save it as grey of 8 or 16 bits")
    return cast("npt.NDArray[np.uint16]", image), _Look(None, image.dtype == np.uint16)


def _encoded(labels: npt.NDArray[np.integer], palette: Palette | None) -> bytes:
    if palette is None:
        return png(cast("npt.NDArray[np.uint16]", labels))
    height, width = labels.shape
    encoder = cast("av.VideoCodecContext", av.CodecContext.create("png", "w"))
    encoder.width, encoder.height, encoder.pix_fmt, encoder.framerate = width, height, "pal8", Fraction(1)
    picture = av.VideoFrame.from_ndarray((labels.astype(np.uint8), palette), format="pal8")  # pyright: ignore
    return b"".join(bytes(packet) for packet in [*encoder.encode(picture), *encoder.encode(None)])

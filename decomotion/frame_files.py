"""Frames as files: which of a folder are meant, in which order, and their pixels. Every room reads them here."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import cast

import cv2
import numpy as np
import numpy.typing as npt

from decomotion.errors import ClipError
from decomotion.frame_gaps import OTHER_SUFFIXES, check_kinds
from decomotion.frame_order import frame_order
from decomotion.frames import READING, Frames, Image, Source
from decomotion.greys import SIDE, Grey, shrunk, size_of_grey
from decomotion.images import Header, as_shown, header, plausible, transparent_grey
from decomotion.source_file import SourceFile

log = logging.getLogger(__name__)

AnyDepth = npt.NDArray[np.uint8] | npt.NDArray[np.uint16]

IMAGE_SUFFIXES = {".jpg", ".jpeg", ".png"}
DEPTHS = (8, 10, 12, 14, 16)
"""Bits that cameras and renderers give to a value; 16-bit files hold any of them."""
JPEG_BLACK = 127
"""A JPEG's edges ring: of a mask, what is not brighter than this is black."""
_REDUCED = {2: cv2.IMREAD_REDUCED_GRAYSCALE_2, 4: cv2.IMREAD_REDUCED_GRAYSCALE_4, 8: cv2.IMREAD_REDUCED_GRAYSCALE_8}


def images_in(folder: Path) -> list[Path]:
    """The .jpg and .png files of a folder in order (`frame_order`).

    Raises `ClipError` where they are of two clips, their order is not clear, or pictures of other kinds are among them.
    """
    visible = [file for file in folder.iterdir() if not file.name.startswith(".")]  # macOS adds ._name.jpg to copies
    names = [file.name for file in visible if file.suffix.lower() in IMAGE_SUFFIXES]
    try:
        check_kinds(names, (file.name for file in visible if file.suffix.lower() in OTHER_SUFFIXES))
        return [folder / name for name in frame_order(names)]
    except ClipError as error:
        raise ClipError(f"in {folder}, {error}") from None


def frame_files(folder: Path) -> list[Path]:
    """The files of a clip's frames in order: those in the folder, or in its `color` subfolder, OmniMotion's layout.

    Raises `ClipError` where there are none, or in both.
    """
    files, inner = images_in(folder), folder / "color"
    if inner.is_dir():
        if files and images_in(inner):
            raise ClipError(f"{folder} holds frames, and so does {inner}; give one of the two")
        files = files or images_in(inner)
    if not files:
        raise ClipError(f"{folder} holds no frames; put .jpg or .png files there, or in {inner}")
    return files


def open_frames(files: Sequence[Path], begin: int = 0, end: int | None = None) -> Frames:
    """The frames of `files[begin:end]`, RGB [H, W, 3], upright: an EXIF orientation is applied.

    Headers tell their sizes; what they do not tell is decoded at once, the rest when it is asked for. 16-bit files
    become 8-bit by one scale for all of `files`, that of the fewest bits of `DEPTHS` that hold their values. Raises
    `ClipError` where a file cannot be read, differs in size, or does not decode; by its header alone now, else then.
    """
    wanted = files[begin:end]
    told = [_header(file) for file in wanted]
    first = told[0] if told else Header(0, 0, 8)
    for file, each in zip(wanted, told, strict=True):
        if (each.height, each.width) != (first.height, first.width):
            raise ClipError(
                f"frame {file} is {each.width}x{each.height} but {wanted[0].name} is {first.width}x{first.height}; "
                "bring all frames to one size"
            )
    bits = None
    if any(each.bits > 8 for each in told):
        others = (file for number, file in enumerate(files) if number not in range(len(files))[begin:end])
        bits = _bits(_read(file) for file in chain(wanted, others))
        if bits < DEPTHS[-1]:
            log.warning("the values in %s need %d of 16 bits and are scaled as such", wanted[0].parent, bits)
    return Frames(_FrameFiles(wanted, first, bits))


class _FrameFiles(Source):
    """Files of frames of one size; `bits` of 16 hold the values of those of 16, None where there are none."""

    def __init__(self, files: Sequence[Path], header: Header, bits: int | None) -> None:
        self._files, self._bits = [_source(file) for file in files], bits
        self.shape = (len(files), header.height, header.width, 3)

    def read(self, number: int) -> Image:
        file = self._files[number]
        file.check()
        frame = _read(file.path)
        if frame.shape != self.shape[1:]:
            raise file.changed()
        return in_8_bits(frame, self._bits or DEPTHS[-1])

    def grey(self, number: int) -> Grey:
        file = self._files[number]
        file.check()
        reduced = _reduced_jpeg(file.path.read_bytes(), max(self.shape[1:3]))
        return super().grey(number) if reduced is None else shrunk(reduced, size_of_grey(*self.shape[1:3]))

    def digest(self, numbers: range) -> str:
        content = hashlib.sha256(f"frames in files {READING} {self.shape[1:3]} {self._bits}".encode())
        for number in numbers:
            content.update(self._files[number].digest.encode())
        return content.hexdigest()[:16]


def _header(file: Path) -> Header:
    content = _content(file)
    told = header(content) if plausible(content) else None
    if told is None:
        frame = _decoded(file, content)
        told = Header(*frame.shape[:2], bits=8 * frame.dtype.itemsize)
    return told


def _reduced_jpeg(content: bytes, longer_side: int) -> Image | None:
    """A JPEG in grey, 2, 4 or 8 times smaller, which is decoded faster, but not below `SIDE`; None of other files."""
    factor = max((factor for factor in _REDUCED if factor * SIDE <= longer_side), default=None)
    if factor is None or content[:2] != b"\xff\xd8":
        return None
    return cast(Image | None, cv2.imdecode(np.frombuffer(content, np.uint8), _REDUCED[factor]))


def in_8_bits(frame: AnyDepth, bits: int = DEPTHS[-1]) -> Image:
    """The frame with values of 8 bits, where 16-bit ones hold `bits`."""
    return (frame if frame.dtype == np.uint8 else frame >> (bits - 8)).astype(np.uint8, copy=False)


def decode_frame(content: bytes, *, upright: bool = True) -> AnyDepth | None:
    """The picture of an image file, RGB [H, W, 3]; None where it does not decode as one of 8 or 16 bits.

    With `upright`, an EXIF orientation is applied.
    """
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH | (0 if upright else cv2.IMREAD_IGNORE_ORIENTATION)
    frame = _decoded_picture(content, flags)
    return None if frame is None else cast(AnyDepth, cv2.cvtColor(frame, cv2.COLOR_BGR2RGB))


def decode_rgba(content: bytes) -> npt.NDArray[np.uint8] | None:
    """The picture of an image file, RGBA [H, W, 4] in 8 bits, opaque where it has no alpha; None where it does not
    decode as one of 8 or 16 bits.
    """
    frame = _decoded_picture(content, cv2.IMREAD_UNCHANGED)
    if frame is None:
        return None
    order = {1: cv2.COLOR_GRAY2RGBA, 3: cv2.COLOR_BGR2RGBA, 4: cv2.COLOR_BGRA2RGBA}
    return in_8_bits(cast(AnyDepth, cv2.cvtColor(frame, order[1 if frame.ndim == 2 else frame.shape[2]])))


def _decoded_picture(content: bytes, flags: int) -> AnyDepth | None:
    """As OpenCV orders its channels."""
    if not plausible(content):  # the memory for all that it says would be taken first
        return None
    try:
        frame = cv2.imdecode(np.frombuffer(content, np.uint8), flags)
    except cv2.error:  # empty, or larger than OpenCV reads
        return None
    if frame is None or frame.dtype not in (np.uint8, np.uint16):  # files of floats, whatever their suffix
        return None
    unchanged = flags == cv2.IMREAD_UNCHANGED  # by which OpenCV leaves it lying as it is
    return cast(AnyDepth, np.ascontiguousarray(as_shown(frame, content)) if unchanged else frame)


def decode_mask(content: bytes, suffix: str) -> npt.NDArray[np.bool_] | None:
    """Where an image file is not black, [H, W]; None where it does not decode. `suffix` is its name's.

    Of a picture with transparent parts, as a cut-out has, it is where it is not transparent.
    """
    image = decode_frame(content)
    if image is None:
        return None
    picture = _decoded_picture(content, cv2.IMREAD_UNCHANGED)
    opaque = None if picture is None else where_opaque(picture, content)
    if opaque is not None and opaque.shape == image.shape[:2]:
        return opaque
    return image.max(axis=-1) > (0 if suffix.lower() == ".png" else JPEG_BLACK)


def where_opaque(picture: AnyDepth, content: bytes) -> npt.NDArray[np.bool_] | None:
    """Where a picture [H, W, 4], or the [H, W] of a file of this content, is not wholly transparent, [H, W].

    None where it is so nowhere.
    """
    opaque = picture[..., 3] > 0 if picture.ndim == 3 and picture.shape[2] == 4 else None
    if picture.ndim == 2 and (value := transparent_grey(content)) is not None:
        opaque = picture != value
    return None if opaque is None or opaque.all() else opaque


def _source(file: Path) -> SourceFile:
    with _telling(file):
        return SourceFile(file)


def _content(file: Path) -> bytes:
    with _telling(file):
        if not file.is_dir() and file.exists() and not file.is_file():
            raise ClipError(f"frame {file} is a pipe or a device; replace it or remove it")
        return file.read_bytes()


@contextmanager
def _telling(file: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise ClipError(f"frame {file} cannot be read ({error.strerror}); replace it or remove it") from error


def _read(file: Path) -> AnyDepth:
    return _decoded(file, _content(file))


def _decoded(file: Path, content: bytes) -> AnyDepth:
    frame = decode_frame(content)
    if frame is None:
        raise ClipError(f"frame {file} does not decode as an image; replace it or remove it")
    return frame


def _bits(frames: Iterable[AnyDepth]) -> int:
    """The fewest of `DEPTHS` that hold the values of all 16-bit frames; read only until that is all 16."""
    bits = DEPTHS[0]
    for frame in frames:
        if frame.dtype == np.uint16:
            bits = next(depth for depth in DEPTHS if depth >= bits and frame.max() < 1 << depth)
        if bits == DEPTHS[-1]:
            break
    return bits

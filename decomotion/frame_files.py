"""Frames as files: which of a folder are meant, in which order, and their pixels. Every room reads them here."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from itertools import chain
from pathlib import Path
from typing import cast

import cv2
import numpy as np
import numpy.typing as npt

from decomotion.errors import ClipError
from decomotion.frame_order import frame_order
from decomotion.images import plausible

log = logging.getLogger(__name__)

Image = npt.NDArray[np.uint8]
AnyDepth = npt.NDArray[np.uint8] | npt.NDArray[np.uint16]

IMAGE_SUFFIXES = {".jpg", ".jpeg", ".png"}
DEPTHS = (8, 10, 12, 14, 16)
"""Bits that cameras and renderers give to a value; 16-bit files hold any of them."""


def images_in(folder: Path) -> list[Path]:
    """The .jpg and .png files of a folder in order (`frame_order`).

    Raises `ClipError` where they are of two clips, or their order is not clear.
    """
    visible = (file for file in folder.iterdir() if not file.name.startswith("."))  # macOS adds ._name.jpg to copies
    names = [file.name for file in visible if file.suffix.lower() in IMAGE_SUFFIXES]
    try:
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


def frame_size(file: Path) -> tuple[int, int]:
    """(width, height) of a frame as it is read."""
    height, width = _read(file).shape[:2]
    return width, height


def read_frames(files: Sequence[Path], begin: int = 0, end: int | None = None) -> list[Image]:
    """The frames of `files[begin:end]`, RGB [H, W, 3], upright: an EXIF orientation is applied.

    16-bit files become 8-bit by one scale for all of `files`, that of the fewest bits of `DEPTHS` that hold their
    values. Raises `ClipError` where one does not decode, or differs in size.
    """
    wanted = files[begin:end]
    frames: list[AnyDepth] = []
    for file in wanted:
        frame = _read(file)
        if frames and frame.shape != frames[0].shape:
            raise ClipError(
                f"frame {file} is {frame.shape[1]}x{frame.shape[0]} but {wanted[0].name} is "
                f"{frames[0].shape[1]}x{frames[0].shape[0]}; bring all frames to one size"
            )
        frames.append(frame)
    if all(frame.dtype == np.uint8 for frame in frames):
        return cast(list[Image], frames)
    others = (_read(file) for number, file in enumerate(files) if number not in range(len(files))[begin:end])
    bits = _bits(chain(frames, others))
    if bits < DEPTHS[-1]:
        log.warning("the values in %s need %d of 16 bits and are scaled as such", wanted[0].parent, bits)
    for number, frame in enumerate(frames):  # one at a time: both kinds at once would take half as much again
        frames[number] = in_8_bits(frame, bits)
    return cast(list[Image], frames)


def in_8_bits(frame: AnyDepth, bits: int = DEPTHS[-1]) -> Image:
    """The frame with values of 8 bits, where 16-bit ones hold `bits`."""
    return (frame if frame.dtype == np.uint8 else frame >> (bits - 8)).astype(np.uint8, copy=False)


def decode_frame(content: bytes, *, upright: bool = True) -> AnyDepth | None:
    """The picture of an image file, RGB [H, W, 3]; None where it does not decode as one of 8 or 16 bits.

    With `upright`, an EXIF orientation is applied.
    """
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH | (0 if upright else cv2.IMREAD_IGNORE_ORIENTATION)
    if not plausible(content):  # the memory for all that it says would be taken first
        return None
    try:
        frame = cv2.imdecode(np.frombuffer(content, np.uint8), flags)
    except cv2.error:  # empty, or larger than OpenCV reads
        return None
    if frame is None or frame.dtype not in (np.uint8, np.uint16):  # files of floats, whatever their suffix
        return None
    return cast(AnyDepth, cv2.cvtColor(frame, cv2.COLOR_BGR2RGB))


def _read(file: Path) -> AnyDepth:
    try:
        frame = decode_frame(file.read_bytes())
    except OSError as error:
        raise ClipError(f"frame {file} cannot be read ({error.strerror}); replace it or remove it") from error
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

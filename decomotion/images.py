"""Pictures: as PNG and JPEG files, and with their gaps filled."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.floating]

PIXELS_PER_BYTE = 8 * 1032
"""Deflate makes at most 1032 bytes of one, of at most 8 pixels each; a JPEG has at least a bit for 64 pixels."""
HUFFMAN_FRAMES = (0xC0, 0xC1, 0xC2)
"""Markers of a JPEG's size where that holds."""
EXIF, ORIENTATION, SHORT = 0xE1, 0x112, 3
"""Marker of EXIF in a JPEG, its tag of how the picture lies, and the kind of that number."""
LAST_UPRIGHT, LAST_ORIENTATION = 4, 8
"""The last value that leaves height and width, and the last of all."""
PNG, GREY = b"\x89PNG", 0
"""How such a file begins, and its colour type of grey alone."""
_ORDERS = {3: cv2.COLOR_RGB2BGR, 4: cv2.COLOR_RGBA2BGRA}


def png(image: npt.NDArray[np.uint8] | npt.NDArray[np.uint16]) -> bytes:
    """The file of a picture of 8 or 16 bits: grey [H, W], RGB [H, W, 3] or RGBA [H, W, 4]."""
    return _encoded(".png", image, ())


def jpeg(image: npt.NDArray[np.uint8], quality: int, full_colour: bool = False) -> bytes:
    """The file of a picture RGB [H, W, 3]; `quality` from 1 to 100, `full_colour` as fine as brightness (4:4:4)."""
    sampling = (cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444) if full_colour else ()
    return _encoded(".jpg", image, (cv2.IMWRITE_JPEG_QUALITY, quality, *sampling))


@dataclass(frozen=True)
class Header:
    """What an image file says of its picture."""

    height: int
    """As it is to be shown: an orientation is applied; as is `width`."""
    width: int
    bits: int
    """Of a value, 8 or 16."""


def header(content: bytes) -> Header | None:
    """Of a whole PNG or JPEG file; None where it is another, is cut short, or says what few do: decode it then."""
    try:
        if content[12:16] == b"IHDR":
            return _header_of_png(content)
        return _header_of_jpeg(content) if content[:2] == b"\xff\xd8" else None
    except (struct.error, IndexError):  # a part that ends behind the file
        return None


def plausible(content: bytes) -> bool:
    """Whether what a PNG or JPEG file says of its size can be in so few bytes; True for other files."""
    try:
        if content[12:16] == b"IHDR":
            _ = tuple(_chunks(content))  # to its end, or an error
            width, height = struct.unpack_from(">II", content, 16)
            return width * height <= PIXELS_PER_BYTE * len(content)
        return content[:2] != b"\xff\xd8" or _plausible_jpeg(content)
    except (struct.error, IndexError):  # a part that ends behind the file
        return False


def _plausible_jpeg(content: bytes) -> bool:
    for marker, place in _segments(content):
        if marker in HUFFMAN_FRAMES:
            height, width = struct.unpack_from(">HH", content, place + 1)
            return width * height <= PIXELS_PER_BYTE * len(content)
    return True


def transparent_grey(content: bytes) -> int | None:
    """The grey that a plausible PNG declares to be transparent, as OpenCV gives it: fewer than 8 bits spread over 8.

    None of others; OpenCV tells of transparent colours itself.
    """
    if not content.startswith(PNG) or content[25] != GREY:
        return None
    place = next((place for kind, place in _chunks(content) if kind == b"tRNS"), None)
    if place is None or struct.unpack_from(">I", content, place - 8)[0] != 2:
        return None
    (value,) = struct.unpack_from(">H", content, place)
    bits = content[24]
    return value if bits == 16 else (value % (1 << bits)) * 255 // ((1 << bits) - 1)


def _header_of_png(content: bytes) -> Header | None:
    if any(kind == b"eXIf" for kind, _ in _chunks(content)):
        return None
    width, height, bits = struct.unpack_from(">IIB", content, 16)
    return Header(height, width, max(8, bits))


def _header_of_jpeg(content: bytes) -> Header | None:
    orientations: list[int | None] = []
    for marker, place in _segments(content):
        if marker == EXIF and content[place : place + 6] == b"Exif\0\0":
            (length,) = struct.unpack_from(">H", content, place - 2)
            orientations.append(_orientation(content[place + 6 : place - 2 + length]))
        if marker in HUFFMAN_FRAMES:
            bits, height, width = struct.unpack_from(">BHH", content, place)
            if bits != 8 or not height or content.rfind(b"\xff\xd9") < place:  # its end
                return None
            if len(orientations) > 1 or None in orientations:  # of which readers make what they will
                return None
            turned = any((each or 1) > LAST_UPRIGHT for each in orientations)
            return Header(width, height, bits) if turned else Header(height, width, bits)
    return None


def _orientation(exif: bytes) -> int | None:
    """What EXIF's first directory says of it, 1 to 8, or 0 or 1 where it says nothing; None where it is damaged."""
    try:
        order = {b"II": "<", b"MM": ">"}[exif[:2]]
        (place,) = struct.unpack_from(f"{order}I", exif, 4)
        (entries,) = struct.unpack_from(f"{order}H", exif, place)
        for entry in range(place + 2, place + 2 + 12 * entries, 12):
            tag, kind, _, value = struct.unpack_from(f"{order}HHIH", exif, entry)
            if tag == ORIENTATION:
                return value if kind == SHORT and value <= LAST_ORIENTATION else None
    except (struct.error, KeyError):
        return None
    return 1


def as_shown(picture: npt.NDArray[Any], content: bytes) -> npt.NDArray[Any]:
    """The picture [H, W, ...] of a plausible file as it is to be shown, where that is a PNG with an orientation."""
    place = next((place for kind, place in _chunks(content) if kind == b"eXIf"), None) if content[:4] == PNG else None
    if place is None:
        return picture
    (length,) = struct.unpack_from(">I", content, place - 8)
    orientation = _orientation(content[place : place + length]) or 1
    turned = picture.swapaxes(0, 1) if orientation > LAST_UPRIGHT else picture
    return turned[:: -1 if orientation in (3, 4, 7, 8) else 1, :: -1 if orientation in (2, 3, 6, 7) else 1]


def _chunks(content: bytes) -> Iterator[tuple[bytes, int]]:
    """The kinds of a PNG's chunks and where their content begins, up to its end.

    Each is length, kind, content, checksum.
    """
    place = 8
    while (kind := content[place + 4 : place + 8]) != b"IEND":
        yield kind, place + 8
        place += 12 + struct.unpack_from(">I", content, place)[0]


def _segments(content: bytes) -> Iterator[tuple[int, int]]:
    """The markers of a JPEG's segments before its picture, and where their content begins."""
    place = 2
    while content[place] == 0xFF:  # marker, length, content
        if content[place + 1] == 0xFF:  # which may be put before a marker
            place += 1
            continue
        marker, length = struct.unpack_from(">xBH", content, place)
        yield marker, place + 4
        place += 2 + length


def _encoded(suffix: str, image: npt.NDArray[np.uint8] | npt.NDArray[np.uint16], options: Sequence[int]) -> bytes:
    ordered = image if image.ndim == 2 else cv2.cvtColor(image, _ORDERS[image.shape[2]])
    done, encoded = cv2.imencode(suffix, ordered, list(options))
    if not done:
        raise OSError(f"OpenCV could not encode a picture of {image.shape} as {suffix}")
    return encoded.tobytes()


def filled(values: Floats, weight: Floats) -> Floats:
    """Values [H, W, C] where `weight` [H, W] is 1, and a smooth continuation where it is 0 (push-pull)."""
    height, width = values.shape[:2]
    if max(height, width) == 1:
        return values
    half = ((width + 1) // 2, (height + 1) // 2)
    coarse_weight = cv2.resize(weight, half, interpolation=cv2.INTER_AREA)
    coarse = cv2.resize(values * weight[..., None], half, interpolation=cv2.INTER_AREA)
    coarse = coarse.reshape(*half[::-1], -1) / np.maximum(coarse_weight, 1e-6)[..., None]
    coarse = filled(coarse, np.minimum(1, 4 * coarse_weight))
    around = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_LINEAR).reshape(values.shape)
    around *= 1 - weight[..., None]
    around += weight[..., None] * values
    return around.astype(np.float32, copy=False)

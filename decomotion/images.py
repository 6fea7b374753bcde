"""Pictures: as PNG and JPEG files, and with their gaps filled."""

from __future__ import annotations

import struct
from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.floating]

PIXELS_PER_BYTE = 8 * 1032
"""Deflate makes at most 1032 bytes of one, of at most 8 pixels each; a JPEG has at least a bit for 64 pixels."""
HUFFMAN_FRAMES = (0xC0, 0xC1, 0xC2)
"""Markers of a JPEG's size where that holds."""
_ORDERS = {3: cv2.COLOR_RGB2BGR, 4: cv2.COLOR_RGBA2BGRA}


def png(image: npt.NDArray[np.uint8]) -> bytes:
    """The file of a picture: grey [H, W], RGB [H, W, 3] or RGBA [H, W, 4]."""
    return _encoded(".png", image, ())


def jpeg(image: npt.NDArray[np.uint8], quality: int, full_colour: bool = False) -> bytes:
    """The file of a picture RGB [H, W, 3]; `quality` from 1 to 100, `full_colour` as fine as brightness (4:4:4)."""
    sampling = (cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444) if full_colour else ()
    return _encoded(".jpg", image, (cv2.IMWRITE_JPEG_QUALITY, quality, *sampling))


def plausible(content: bytes) -> bool:
    """Whether what a PNG or JPEG file says of its size can be in so few bytes; True for other files."""
    try:
        if content[12:16] == b"IHDR":
            return _plausible_png(content)
        return content[:2] != b"\xff\xd8" or _plausible_jpeg(content)
    except (struct.error, IndexError):  # a part that ends behind the file
        return False


def _plausible_png(content: bytes) -> bool:
    width, height = struct.unpack_from(">II", content, 16)
    place = 8
    while content[place + 4 : place + 8] != b"IEND":  # chunks: length, kind, content, checksum
        place += 12 + struct.unpack_from(">I", content, place)[0]
    return width * height <= PIXELS_PER_BYTE * len(content)


def _plausible_jpeg(content: bytes) -> bool:
    place = 2
    while content[place] == 0xFF:  # segments: marker, length, content
        marker, length = struct.unpack_from(">xBH", content, place)
        if marker in HUFFMAN_FRAMES:
            height, width = struct.unpack_from(">HH", content, place + 5)
            return width * height <= PIXELS_PER_BYTE * len(content)
        place += 2 + length
    return True


def _encoded(suffix: str, image: npt.NDArray[np.uint8], options: Sequence[int]) -> bytes:
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
    return (weight[..., None] * values + (1 - weight[..., None]) * around).astype(np.float32)

"""Pictures: masks of the user, and frames inside a dataset (`decomotion/frame_files.py` decodes both)."""

from __future__ import annotations

import re
import resource
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clip_files import turned_jpeg
from decomotion.data.masks.folder import read_masks
from decomotion.errors import ClipError
from decomotion.frame_files import decode_frame, open_frames
from decomotion.images import header, jpeg, plausible, png
from near_misses import EXTREMES, answer, any_or_near

HEIGHT, WIDTH = 6, 9
PICTURE = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)


def chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


@st.composite
def forged_png(draw: st.DrawFn) -> bytes:
    """A PNG file of whole chunks whose header tells another size, depth or colour than its pixels have."""
    sides = st.sampled_from((WIDTH, HEIGHT, 0, 1, 20_000, 40_000, 2**20, *EXTREMES))
    width, height = (draw(sides) % 2**32 for _ in range(2))
    depth, colour = draw(st.sampled_from((1, 2, 4, 8, 16, 0, 255))), draw(st.sampled_from((0, 2, 3, 4, 6, 1, 255)))
    rows = zlib.compress(draw(st.sampled_from((b"", bytes(HEIGHT * (1 + WIDTH)), b"\xff" * 4000, bytes(10**6)))))
    header = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, draw(st.integers(0, 2)))
    parts = [chunk(b"IHDR", header), chunk(b"PLTE", bytes(3)), chunk(b"IDAT", rows), chunk(b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(draw(st.permutations(parts)) if draw(st.booleans()) else parts)


def others() -> list[bytes]:
    """Pictures of other kinds than the folder's suffix promises, as far as this OpenCV writes them."""
    kinds = [(".bmp", PICTURE), (".webp", PICTURE), (".tiff", PICTURE.astype(np.float32)), (".hdr", PICTURE / 9)]
    kinds += [(".tiff", PICTURE.astype(np.float64)), (".png", PICTURE.astype(np.uint16) * 200)]
    return [cv2.imencode(kind, picture.astype(picture.dtype))[1].tobytes() for kind, picture in kinds]


CONTENTS = st.one_of(any_or_near(png(PICTURE), jpeg(PICTURE, 90), *others()), forged_png(), st.sampled_from(others()))


LYING = {
    "many pixels": jpeg(PICTURE, 90).replace(struct.pack(">HH", HEIGHT, WIDTH), struct.pack(">HH", 20_000, 20_000), 1),
    "much content": re.sub(rb"....IDAT", b"\xff\xff\xff\xf0IDAT", png(PICTURE), count=1, flags=re.DOTALL),
}


@pytest.mark.parametrize("lie", LYING)
def test_a_size_takes_no_memory(lie: str):
    """Of a picture of a few hundred bytes."""
    begin = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert decode_frame(LYING[lie]) is None
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < begin + 2**18  # 256 MiB, in KiB


@pytest.mark.parametrize("content", [png(PICTURE), jpeg(PICTURE, 90)])
def test_what_follows_a_picture_is_not_read(content: bytes):
    frame = decode_frame(content + b"\xff" * 50)
    assert frame is not None
    np.testing.assert_array_equal(frame, decode_frame(content))


@pytest.mark.parametrize("kind", ["png", "jpg"])
@pytest.mark.parametrize("value", [0, 128])
def test_the_emptiest_pictures_are_read(kind: str, value: int):
    """A large one of a single colour has as many pixels in a byte as there can be."""
    picture = np.full((3000, 2000, 3), value, np.uint8)
    content = cv2.imencode(".png", picture[..., 0], [cv2.IMWRITE_PNG_BILEVEL, 1, cv2.IMWRITE_PNG_COMPRESSION, 9])[1]
    progressive = [cv2.IMWRITE_JPEG_PROGRESSIVE, 1, cv2.IMWRITE_JPEG_QUALITY, 1, cv2.IMWRITE_JPEG_OPTIMIZE, 1]
    frame = decode_frame((content if kind == "png" else cv2.imencode(".jpg", picture, progressive)[1]).tobytes())
    assert frame is not None
    assert frame.shape == picture.shape


@given(content=CONTENTS, upright=st.booleans())
def test_picture(content: bytes, upright: bool):
    frame = answer(lambda: decode_frame(content, upright=upright))
    if frame is not None:
        assert frame.ndim == 3
        assert frame.shape[2] == 3
        assert frame.dtype in (np.uint8, np.uint16)


@given(content=any_or_near(turned_jpeg(PICTURE, 6), turned_jpeg(PICTURE, 2), png(PICTURE)))
def test_a_header_tells_what_decoding_gives(content: bytes):
    told, frame = answer(lambda: header(content) if plausible(content) else None), decode_frame(content)
    assert told is None or frame is None or (told.height, told.width) == frame.shape[:2]


@pytest.mark.parametrize("name", ["0.png", "0.jpg"])
@given(content=CONTENTS)
def test_masks_and_frames(place: Path, name: str, content: bytes):
    folder = place / name
    folder.mkdir(exist_ok=True)
    (folder / name).write_bytes(content)
    masks = answer(lambda: read_masks(folder, 1, HEIGHT, WIDTH))
    if masks is not None:
        assert [mask.shape for mask in masks] == [(HEIGHT, WIDTH)]
        assert masks[0].dtype == bool
    frames = answer(lambda: open_frames([folder / name]), ClipError)
    if frames is not None:
        read = answer(lambda: frames[0], ClipError)
        assert read is None or (read.dtype, read.shape) == (np.uint8, frames.shape[1:])

"""Pictures as files."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from clip_files import shown_by_exif, turned_jpeg
from decomotion.images import Header, filled, header, jpeg, png

BACK = {3: cv2.COLOR_BGR2RGB, 4: cv2.COLOR_BGRA2RGBA}


@pytest.mark.parametrize("shape", [(5, 7), (5, 7, 3), (5, 7, 4)])
def test_png_is_lossless(shape: tuple[int, ...]):
    picture = np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)
    decoded = cv2.imdecode(np.frombuffer(png(picture), np.uint8), cv2.IMREAD_UNCHANGED)
    assert decoded is not None
    np.testing.assert_array_equal(decoded if decoded.ndim == 2 else cv2.cvtColor(decoded, BACK[shape[2]]), picture)


@pytest.mark.parametrize(("full_colour", "apart"), [(True, (0, 4)), (False, (8, 255))])
def test_jpeg_with_fine_or_coarse_colour(full_colour: bool, apart: tuple[float, float]):
    """Columns of one pixel, red and green by turns."""
    picture = np.zeros((16, 16, 3), np.uint8)
    picture[:, ::2, 0] = picture[:, 1::2, 1] = 200
    decoded = cv2.imdecode(np.frombuffer(jpeg(picture, 100, full_colour), np.uint8), cv2.IMREAD_COLOR)
    assert decoded is not None
    error = np.abs(cv2.cvtColor(decoded, cv2.COLOR_BGR2RGB).astype(int) - picture).mean()
    assert apart[0] <= error <= apart[1]


def test_a_picture_that_opencv_cannot_encode():
    with pytest.raises((OSError, cv2.error)):
        png(np.zeros((0, 4, 3), np.uint8))


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (16, 16), (13, 29)])
def test_gaps_are_filled_with_what_is_around(shape: tuple[int, int]):
    random = np.random.default_rng(0)
    values = random.random((*shape, 2)).astype(np.float32)
    weight = (random.random(shape) < 0.3).astype(np.float32)
    weight[0, 0] = 1
    known = weight == 1
    whole = filled(np.where(known[..., None], values, 99), weight)
    np.testing.assert_array_equal(whole[known], values[known])
    assert whole.max() <= values[known].max() + 1e-5
    assert whole.min() >= values[known].min() - 1e-5
    np.testing.assert_allclose(filled(np.full((*shape, 2), 3, np.float32), weight), 3, atol=1e-5)


class TestHeader:
    """What a file says of its picture is what decoding gives."""

    picture = np.random.default_rng(0).integers(0, 256, (13, 29, 3), dtype=np.uint8)

    @pytest.mark.parametrize("bits", [8, 16])
    @pytest.mark.parametrize("channels", [1, 3, 4])
    def test_of_png(self, bits: int, channels: int):
        picture = np.zeros((13, 29, channels), f"uint{bits}")
        content = cv2.imencode(".png", picture)[1].tobytes()
        assert header(content) == Header(13, 29, bits)

    @pytest.mark.parametrize("progressive", [0, 1])
    def test_of_jpeg(self, progressive: int):
        for picture in (self.picture, self.picture[..., 0]):
            content = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_PROGRESSIVE, progressive])[1].tobytes()
            assert header(content) == Header(13, 29, 8)
            assert header(content + b"what a camera puts behind it") == Header(13, 29, 8)

    @pytest.mark.parametrize("orientation", range(1, 9))
    def test_of_jpeg_that_lies_otherwise(self, orientation: int):
        found = header(turned_jpeg(self.picture, orientation))
        assert found == Header(*shown_by_exif(self.picture, orientation).shape[:2], bits=8)

    @pytest.mark.parametrize("suffix", [".png", ".jpg"])
    def test_of_a_file_cut_short_there_is_none(self, suffix: str):
        content = cv2.imencode(suffix, self.picture)[1].tobytes()
        assert header(content) is not None
        for end in range(0, len(content) - 12, 7):  # a PNG's last chunk has 12 bytes
            assert header(content[:end]) is None

    def test_of_other_files_there_is_none(self):
        for suffix in (".bmp", ".webp", ".tiff"):
            assert header(cv2.imencode(suffix, self.picture)[1].tobytes()) is None
        assert header(b"") is None

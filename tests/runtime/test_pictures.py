from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from decomo_runtime.pictures import evened, flattened, tiled, write_png, write_sequence, write_video

RED, BLUE = (220, 30, 40), (30, 60, 210)


def two_colours() -> np.ndarray:
    frame = np.empty((48, 64, 3), np.uint8)
    frame[:24], frame[24:] = RED, BLUE
    return frame


@pytest.mark.parametrize("fps", [24.0, 30000 / 1001, 12.5])
def test_video_plays_in_browsers(tmp_path: Path, fps: float):
    path = tmp_path / "new" / "a.mp4"
    write_video(path, [two_colours()] * 5, fps)
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")
        assert stream.average_rate == Fraction(fps).limit_denominator(1001)
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
    assert [frame.shape for frame in frames] == [(48, 64, 3)] * 5
    content = path.read_bytes()
    assert content.index(b"moov") < content.index(b"mdat")  # the index in front: plays before it is loaded whole
    for frame in frames:
        np.testing.assert_allclose(frame[10, 30], RED, atol=6)  # 8-bit YUV and the encoder's loss
        np.testing.assert_allclose(frame[36, 30], BLUE, atol=6)
    assert list(path.parent.iterdir()) == [path]


def test_one_frame(tmp_path: Path):
    write_video(tmp_path / "a.mp4", iter([two_colours()]), 24.0)
    with av.open(str(tmp_path / "a.mp4")) as container:
        assert len(list(container.decode(video=0))) == 1


def test_an_interrupted_video_leaves_nothing(tmp_path: Path):
    def frames() -> Iterator[np.ndarray]:
        yield two_colours()
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_video(tmp_path / "a.mp4", frames(), 24.0)
    assert not list(tmp_path.iterdir())


def test_png(tmp_path: Path):
    write_png(tmp_path / "a.png", two_colours())
    read = cv2.imread(str(tmp_path / "a.png"))
    assert read is not None
    np.testing.assert_array_equal(read[..., ::-1], two_colours())


def half_clear() -> np.ndarray:
    """Two colours, the left half clear, the right half opaque."""
    alpha = np.zeros((48, 64, 1), np.uint8)
    alpha[:, 32:] = 255
    return np.concatenate([two_colours(), alpha], axis=2)


@pytest.mark.parametrize(
    ("suffix", "codec", "decoder", "pixels"),
    [(".webm", "vp9", "libvpx-vp9", "yuva420p"), (".mov", "prores", "prores", "yuva444p12le")],
)
def test_video_with_alpha(tmp_path: Path, suffix: str, codec: str, decoder: str, pixels: str):
    """Decoded by the library's own decoder of VP9: FFmpeg's leaves alpha out."""
    path = tmp_path / f"a{suffix}"
    write_video(path, [half_clear()] * 3, 24.0)
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert stream.codec_context.name == codec
        assert stream.metadata.get("alpha_mode", "1") == "1"
        context = av.CodecContext.create(decoder, "r")
        context.extradata, context.codec_tag = stream.codec_context.extradata, stream.codec_context.codec_tag
        frames = [frame for packet in container.demux(stream) for frame in context.decode(packet)]
    assert len(frames) == 3
    for frame in frames:
        assert frame.format.name == pixels
        image = frame.to_ndarray(format="rgba")
        np.testing.assert_allclose(image[:, :30, 3], 0, atol=3)
        np.testing.assert_allclose(image[:, 34:, 3], 255, atol=3)
        np.testing.assert_allclose(image[10, 50, :3], RED, atol=8)  # 8-bit YUV and the encoder's loss


@pytest.mark.parametrize("suffix", [".webm", ".mov"])
def test_the_other_forms_take_rgb_too(tmp_path: Path, suffix: str):
    write_video(tmp_path / f"a{suffix}", [two_colours()] * 2, 24.0)
    with av.open(str(tmp_path / f"a{suffix}")) as container:
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert len(frames) == 2
    np.testing.assert_allclose(frames[1][36, 30], BLUE, atol=8)  # as above


def test_png_with_alpha(tmp_path: Path):
    write_png(tmp_path / "a.png", half_clear())
    read = cv2.imread(str(tmp_path / "a.png"), cv2.IMREAD_UNCHANGED)
    assert read is not None
    np.testing.assert_array_equal(read[..., [2, 1, 0, 3]], half_clear())


def test_a_sequence_is_whole_or_not_there(tmp_path: Path):
    write_sequence(tmp_path / "a", [("0", two_colours()), ("x/0", half_clear())])
    assert sorted(str(path.relative_to(tmp_path / "a")) for path in (tmp_path / "a").rglob("*.png")) == [
        *("0.png", "x/0.png")
    ]

    def images() -> Iterator[tuple[str, np.ndarray]]:
        yield "0", two_colours()
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_sequence(tmp_path / "b", images())
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


@pytest.mark.parametrize(("shape", "even"), [((4, 6), (4, 6)), ((5, 6), (6, 6)), ((1, 3), (2, 4))])
def test_evened(shape: tuple[int, int], even: tuple[int, int]):
    image = np.random.default_rng(0).integers(0, 256, (*shape, 4), np.uint8)
    result = evened(image)
    assert result.shape == (*even, 4)
    np.testing.assert_array_equal(result[: shape[0], : shape[1]], image)
    np.testing.assert_array_equal(result[-1, -1], image[-1, -1])


def test_flattened_shows_chequers_where_it_is_clear():
    flat = flattened(half_clear(), cell=8)
    np.testing.assert_array_equal(flat[:, 32:], two_colours()[:, 32:])
    assert flat[0, 0].tolist() == [153] * 3
    assert flat[0, 8].tolist() == [204] * 3
    assert flat[8, 8].tolist() == [153] * 3
    np.testing.assert_array_equal(flattened(two_colours()), two_colours())


def test_tiled():
    images = [np.full((2, 3, 3), value, np.uint8) for value in (10, 20, 30)]
    sheet = tiled(images, 2)
    assert sheet[..., 0].tolist() == [[10] * 3 + [20] * 3] * 2 + [[30] * 3 + [0] * 3] * 2
    np.testing.assert_array_equal(tiled(images[:1], 1), images[0])

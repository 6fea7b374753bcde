from __future__ import annotations

import re
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from decomo_runtime.errors import RenderError
from decomo_runtime.pictures import evened, flattened, tiled, write_png, write_sequence, write_video
from full_disk import writes_end_at

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


FORMS = [".mp4", ".webm", ".mov"]


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(
    ("fps", "times", "told"),
    [
        (1e-6, None, "no video can show a frame for 1e[+]06 s, at most 100,000; write images instead"),
        (1e-6, [0, 1e6, 2e6], "for 1e[+]06 s, at most 100,000"),
        (24.0, [0, 1, 200_001], "for 200000 s, at most 100,000"),
        (1e300, None, "no video can have 1e[+]300 frames a second, at most 1,000,000; write images instead"),
        (1e300, [0, 1, 2.5], "1e[+]300 frames a second"),
        (0.0, None, "0 frames a second"),
        (float("nan"), None, "nan frames a second"),
    ],
)
def test_rates_that_no_video_can_have(tmp_path: Path, form: str, fps: float, times: list[float] | None, told: str):
    with pytest.raises(RenderError, match=told):
        write_video(tmp_path / f"a{form}", [two_colours()] * 3, fps, times=times)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("form", FORMS)
def test_the_slowest_and_the_fastest_video(tmp_path: Path, form: str):
    write_video(tmp_path / f"fast{form}", [two_colours()] * 3, 1e6)
    write_video(tmp_path / f"slow{form}", [two_colours()] * 3, 1e-5)
    assert shown_at(tmp_path / f"slow{form}")[0] == [0, 1e5, 2e5]


def noise(frames: int) -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, (frames, 48, 64, 3), np.uint8)


def shown_at(path: Path) -> tuple[list[float], float]:
    """The second at which each frame is shown, and the length of the whole."""
    with av.open(f"file:{path}") as container:
        times = [frame.time for frame in container.decode(video=0) if frame.time is not None]
        assert container.duration is not None
        return times, container.duration / av.time_base


@pytest.mark.parametrize("form", FORMS)
def test_frames_of_a_variable_rate_are_shown_when_they_were_taken(tmp_path: Path, form: str):
    path = tmp_path / f"a{form}"
    times = np.cumsum([2.5, *[0.033] * 7, *[0.1] * 6])  # a recording that says 30 a second and has 15
    write_video(path, noise(len(times)), 30.0, times=times)
    shown, length = shown_at(path)
    np.testing.assert_allclose(shown, times - 2.5, atol=0.001)  # webm counts milliseconds
    assert length == pytest.approx(times[-1] - 2.5 + 0.1, abs=0.001)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("seconds", [1.6, 2000.0, 86400.0])
def test_a_slow_time_lapse_is_slow(tmp_path: Path, form: str, seconds: float):
    for number, times in enumerate([None, 7 + seconds * np.arange(5)]):
        write_video(tmp_path / f"{number}{form}", noise(5), 1 / seconds, times=times)
        shown, length = shown_at(tmp_path / f"{number}{form}")
        np.testing.assert_allclose(shown, seconds * np.arange(5), atol=0.001)
        assert length == pytest.approx(5 * seconds, abs=0.001)


def test_milliseconds_are_a_steady_rate(tmp_path: Path):
    """Matroska counts them: frames at 30 a second come at 0, 33, 67, 100."""
    times = np.rint(1000 * np.arange(12) / 30) / 1000
    write_video(tmp_path / "a.mp4", noise(12), 30.0, times=times)
    write_video(tmp_path / "b.mp4", noise(12), 30.0)
    assert (tmp_path / "a.mp4").read_bytes() == (tmp_path / "b.mp4").read_bytes()


@pytest.mark.parametrize("form", FORMS)
def test_times_that_are_no_times_lose_no_frame(tmp_path: Path, form: str):
    write_video(tmp_path / f"a{form}", noise(4), 30.0, times=[0.0, 0.1, 0.1, 0.2])
    shown, _ = shown_at(tmp_path / f"a{form}")
    assert len(set(shown)) == 4


@pytest.mark.parametrize("name", ["m:1", "12:30:00", "a%d", "a%03d", "pipe:", "file:a", "http:x", "C:\\a", "a?b#c"])
def test_names_are_no_protocols_and_no_patterns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str):
    monkeypatch.chdir(tmp_path)
    for form in FORMS:
        write_video(f"{name}{form}", noise(2), 24.0)
    assert sorted(file.name for file in tmp_path.iterdir()) == sorted(f"{name}{form}" for form in FORMS)


@pytest.mark.parametrize("aspect", [16 / 11, 8 / 9])
def test_pixels_that_are_not_square(tmp_path: Path, aspect: float):
    for form in FORMS:
        write_video(tmp_path / f"a{form}", noise(2), 24.0, pixel_aspect=aspect)
        with av.open(str(tmp_path / f"a{form}")) as container:
            stream = container.streams.video[0]
            shape = Fraction(stream.width, stream.height) * (stream.sample_aspect_ratio or 1)
            assert float(shape) == pytest.approx(64 / 48 * aspect, rel=0.03)  # of a webm: even numbers of pixels
            assert (stream.width == 64 and stream.height == 48) == (form != ".webm")


@pytest.mark.parametrize("form", FORMS)
def test_a_full_disk_leaves_nothing(tmp_path: Path, form: str):
    path = tmp_path / f"a{form}"
    with writes_end_at(50_000), pytest.raises(OSError, match=re.escape(str(path))) as failure:
        write_video(path, noise(60), 24.0)
    assert failure.value.filename == str(path)
    assert list(tmp_path.iterdir()) == []


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


def test_alpha_is_kept_up_to_a_border_inside_a_block(tmp_path: Path):
    alpha = np.zeros((480, 854), np.uint8)
    alpha[100:400, 50:300] = 255
    frame = np.dstack([np.full((480, 854, 3), 90, np.uint8), alpha])
    write_video(tmp_path / "alpha.mov", [frame] * 8, 24)
    with av.open(str(tmp_path / "alpha.mov")) as container:
        for decoded in container.decode(video=0):
            np.testing.assert_allclose(decoded.to_ndarray(format="rgba")[..., 3], alpha, atol=1)


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

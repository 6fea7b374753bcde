from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from decomo_runtime.pictures import write_png, write_video

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

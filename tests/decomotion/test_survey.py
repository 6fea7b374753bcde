"""Parts of a video that was opened before: the same as opened by themselves, without decoding what lies before."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from clip_files import with_display_matrix, write_video
from decomotion import video, video_frames
from decomotion.cache import cache_root
from decomotion.clip import read_clip
from decomotion.errors import ClipError
from decomotion.frames import Frames
from films import B_FRAMES, COUNT, FORMS, GOP, drifting, lowest_row_first, plainly_decoded, write

STARTS, FRAMES = range(COUNT - 3), 3
IN_DOUBT = {"AVI with B-frames", "a bare stream"}
"""Forms that do not say when frames are shown."""


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("DECOMO_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache" / "videos"


@pytest.fixture
def decoded(monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """What opening and reading have decoded so far."""
    frames: list[object] = []
    plain = video.decoded

    def counting(*arguments: Any) -> Iterator[object]:
        for frame in plain(*arguments):
            frames.append(frame.pts)
            yield frame

    monkeypatch.setattr(video, "decoded", counting)
    monkeypatch.setattr(video_frames, "decoded", counting)
    return frames


@pytest.fixture
def film(tmp_path: Path) -> Path:
    return write(tmp_path / "film.mp4", "libx264", B_FRAMES)


def check_every_start(path: Path, cache: Path, caplog: pytest.LogCaptureFixture, *, kept: bool = True) -> None:
    """Every start, and some against what the part is where the cache knows nothing."""
    expected = list(plainly_decoded(path))
    whole = read_clip(path)
    assert len(whole) == COUNT == len(expected)
    assert len(list(cache.glob("*.npz"))) == kept
    for begin in STARTS:
        part = read_clip(f"{path}@{begin}:{begin + FRAMES}")
        assert len(part) == FRAMES
        for number in (0, FRAMES - 1):
            np.testing.assert_array_equal(part.frames[number], expected[begin + number], err_msg=f"{begin}, {number}")
    for begin, end in ((0, 2), (3, 40), (37, 61), (50, COUNT)):
        caplog.clear()
        part = read_clip(f"{path}@{begin}:{end}")
        said = caplog.messages.copy()
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("DECOMO_CACHE", str(cache.parent / f"none-{begin}"))
            caplog.clear()
            alone = read_clip(f"{path}@{begin}:{end}")
        assert said == caplog.messages
        np.testing.assert_array_equal(part.times, alone.times)
        assert (part.frames.shape, part.pixel_aspect, part.digest()) == (
            alone.frames.shape,
            alone.pixel_aspect,
            alone.digest(),
        )
        assert isinstance(part.frames, Frames)
        assert isinstance(alone.frames, Frames)
        for number in (0, len(part) // 2):
            np.testing.assert_array_equal(part.frames.grey(number), alone.frames.grey(number))


@pytest.mark.parametrize("form", FORMS)
def test_every_start(form: str, tmp_path: Path, cache: Path, caplog: pytest.LogCaptureFixture):
    name, codec, options = FORMS[form]
    check_every_start(write(tmp_path / name, codec, options), cache, caplog, kept=form not in IN_DOUBT)


@pytest.mark.parametrize("suffix", [".mp4", ".mkv"])
def test_every_start_at_a_variable_rate(suffix: str, tmp_path: Path, cache: Path, caplog: pytest.LogCaptureFixture):
    times = np.cumsum(np.random.default_rng(1).integers(8, 120, COUNT)).tolist()
    check_every_start(write(tmp_path / f"film{suffix}", "libx264", B_FRAMES, times), cache, caplog)


@pytest.mark.parametrize("begin", [500, 5000])
def test_every_start_behind_an_edit_list(begin: int, tmp_path: Path, cache: Path, caplog: pytest.LogCaptureFixture):
    times = [begin + 40 * number for number in range(COUNT)]
    check_every_start(write(tmp_path / "film.mp4", "libx264", B_FRAMES, times), cache, caplog)


def test_every_start_where_frames_stood_still(tmp_path: Path, cache: Path, caplog: pytest.LogCaptureFixture):
    """What is said of a part, that frames are missing, is said of it again."""
    times = [40 * number + 400 * (number > 20) for number in range(COUNT)]
    check_every_start(write(tmp_path / "film.mp4", "libx264", B_FRAMES, times), cache, caplog)


def test_every_start_of_pictures_from_the_lowest_row_up(tmp_path: Path, cache: Path, caplog: pytest.LogCaptureFixture):
    check_every_start(lowest_row_first(tmp_path), cache, caplog)


class TestWork:
    def test_opening_decodes_nothing_and_reading_begins_at_a_key_frame(self, film: Path, decoded: list[object]):
        part = f"{film}@60:70"
        list(read_clip(part).frames)
        alone = len(decoded)
        read_clip(film)
        decoded.clear()
        list(read_clip(part).frames)
        assert alone >= 80
        assert len(decoded) <= 12

    def test_windows_of_a_part_too(self, film: Path, decoded: list[object]):
        read_clip(f"{film}@10:70")
        decoded.clear()
        read_clip(f"{film}@40:60")
        assert decoded == []
        read_clip(f"{film}@40:71")
        assert len(decoded) == 71

    def test_a_whole_video_is_looked_at_anew_and_noted_once(self, film: Path, cache: Path, decoded: list[object]):
        noted = set()
        for _ in range(2):
            decoded.clear()
            read_clip(film)
            assert len(decoded) == COUNT
            noted.add(next(cache.iterdir()).stat().st_ino)
        assert len(noted) == 1

    def test_small_pictures_that_are_averages(self, tmp_path: Path):
        path = write_video(tmp_path / "film.mp4", drifting(14, 122, 230))
        whole, part = read_clip(path), read_clip(f"{path}@4:9")
        assert isinstance(whole.frames, Frames)
        assert isinstance(part.frames, Frames)
        for number in range(5):
            np.testing.assert_array_equal(part.frames.grey(number), whole.frames.grey(4 + number))


class TestDoubt:
    def test_damaged(self, tmp_path: Path, cache: Path):
        """With a hole in a group of pictures: decoded from the beginning, as always."""
        path = write(tmp_path / "film.mp4", "libx264", GOP | {"bf": "0"})
        content = bytearray(path.read_bytes())
        with av.open(str(path)) as file:
            places = [packet.pos or 0 for packet in file.demux(video=0) if packet.size]
        content[places[26] + 30 : places[28] + 30] = bytes(places[28] - places[26])
        path.write_bytes(content)
        whole = read_clip(path)
        assert len(whole) < COUNT
        assert not cache.exists()
        part = read_clip(f"{path}@30:50")
        for number in range(20):
            np.testing.assert_array_equal(part.frames[number], whole.frames[30 + number])

    def test_written_to_unseen(self, film: Path, decoded: list[object]):
        """In the same moment, with as many bytes: only the system's own note of the change tells."""
        read_clip(film)
        before = film.stat()
        write_video(film, drifting(30), options={"crf": "45"})
        film.write_bytes(film.read_bytes()[: before.st_size].ljust(before.st_size, b"\0"))
        os.utime(film, ns=(before.st_atime_ns, before.st_mtime_ns))
        decoded.clear()
        with pytest.raises(ClipError, match=r"has frames 0 to 29; @40:60 is not two or more"):
            read_clip(f"{film}@40:60")
        assert len(decoded) == 30

    @pytest.mark.parametrize("content", [b"", b"not an archive", None])
    def test_what_was_kept_is_damaged(self, content: bytes | None, film: Path, cache: Path, decoded: list[object]):
        read_clip(film)
        (kept,) = cache.iterdir()
        kept.write_bytes(kept.read_bytes()[:200] if content is None else content)
        decoded.clear()
        part = read_clip(f"{film}@40:60")
        assert len(decoded) == 60
        np.testing.assert_array_equal(part.frames[3], list(plainly_decoded(film))[43])
        decoded.clear()
        read_clip(f"{film}@41:60")
        assert decoded == []

    def test_no_room(self, film: Path, cache: Path):
        cache.parent.mkdir()
        cache.touch()
        assert len(read_clip(film)) == COUNT
        assert len(read_clip(f"{film}@40:60")) == 20

    def test_the_cache_is_where_it_is_said(self, film: Path, cache: Path):
        read_clip(film)
        assert [file.parent for file in cache_root().rglob("*.npz")] == [cache]


@pytest.mark.parametrize("matrix", [(0, 1, -1, 0), (0, -1, 1, 0), (0, -1, -1, 0)])
def test_parts_of_a_video_that_lies_on_its_side(matrix: tuple[int, int, int, int], tmp_path: Path, cache: Path):
    path = with_display_matrix(write_video(tmp_path / "film.mp4", drifting(14, 62, 94)), matrix)
    whole = read_clip(path)
    assert len(list(cache.glob("*.npz"))) == 1
    part = read_clip(f"{path}@4:9")
    assert (part.height, part.width) == (94, 62)
    np.testing.assert_array_equal(part.frames, np.asarray(whole.frames)[4:9])


def test_parts_of_a_video_that_begins_after_a_month(tmp_path: Path, decoded: list[object]):
    """Its times in milliseconds have more than 32 bits."""
    times = [3_000_000_000 + 40 * number for number in range(14)]
    path = write_video(tmp_path / "film.mkv", drifting(14, 62, 94), times=times)
    whole = read_clip(path)
    decoded.clear()
    part = read_clip(f"{path}@4:9")
    assert decoded == []
    np.testing.assert_array_equal(part.frames, np.asarray(whole.frames)[4:9])

"""Frames of a video asked for in any order are those of one that is read from its beginning."""

from __future__ import annotations

import os
import random
import shutil
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from clip_files import write_video
from decomotion import video_frames
from decomotion.clip import Clip, read_clip
from decomotion.data.cuts import find_cuts
from decomotion.decoding import mark
from decomotion.errors import ClipError
from decomotion.frames import Frames
from films import B_FRAMES, COUNT, FORMS, GOP, by_a_palette, drifting, lowest_row_first, plainly_decoded, write


def check_any_order(path: Path, begin: int = 0, end: int = COUNT) -> None:
    expected = list(plainly_decoded(path))[begin:end]
    where = path if (begin, end) == (0, COUNT) else f"{path}@{begin}:{end}"
    clip = read_clip(where)
    assert len(clip) == len(expected)
    for frame, other in zip(clip.frames, expected, strict=True):
        np.testing.assert_array_equal(frame, other)
    order = [number for number in range(len(expected)) for _ in range(2)]
    random.Random(0).shuffle(order)
    for numbers in (order, range(len(expected) - 1, -1, -1), range(0, len(expected), 7)):
        fresh = read_clip(where)
        for number in numbers:
            np.testing.assert_array_equal(fresh.frames[number], expected[number], err_msg=f"frame {number}")


@pytest.mark.parametrize("form", FORMS)
def test_any_order(form: str, tmp_path: Path):
    name, codec, options = FORMS[form]
    check_any_order(write(tmp_path / name, codec, options))


@pytest.mark.parametrize("suffix", [".mp4", ".mkv"])
def test_any_order_at_a_variable_rate(suffix: str, tmp_path: Path):
    steps = np.random.default_rng(1).integers(8, 120, COUNT)
    check_any_order(write(tmp_path / f"film{suffix}", "libx264", B_FRAMES, np.cumsum(steps).tolist()))


@pytest.mark.parametrize("begin", [500, 5000])
def test_any_order_behind_an_edit_list(begin: int, tmp_path: Path):
    """The film begins late: an empty edit, and one that shifts the times of B-frames."""
    times = [begin + 40 * number for number in range(COUNT)]
    check_any_order(write(tmp_path / "film.mp4", "libx264", B_FRAMES, times))


@pytest.mark.parametrize("form", ["B-frames", "open groups", "AVI with B-frames"])
def test_any_order_in_a_part(form: str, tmp_path: Path):
    name, codec, options = FORMS[form]
    check_any_order(write(tmp_path / name, codec, options), 29, 61)


def test_any_order_of_pictures_from_the_lowest_row_up(tmp_path: Path):
    check_any_order(lowest_row_first(tmp_path))


def test_any_order_of_pictures_by_a_palette(tmp_path: Path):
    path = by_a_palette(tmp_path)
    assert {int(frame[0, 0, 1]) for frame in plainly_decoded(path)} == {40, 200}
    check_any_order(path)


@pytest.mark.parametrize("suffix", [".mp4", ".mkv"])
def test_any_order_in_a_damaged_film(suffix: str, tmp_path: Path):
    """With a hole in one group of pictures, and without its end."""
    path = write(tmp_path / f"film{suffix}", "libx264", GOP | {"bf": "0"})
    content = bytearray(path.read_bytes())
    with av.open(str(path)) as file:
        places = [packet.pos or 0 for packet in file.demux(video=0) if packet.size]
    content[places[26] + 30 : places[28] + 30] = bytes(places[28] - places[26])
    path.write_bytes(content[: places[70] + 20])
    expected = [np.array(frame) for frame in read_clip(path).frames]
    assert 45 < len(expected) < 71
    clip, order = read_clip(path), list(range(len(expected)))
    random.Random(0).shuffle(order)
    for number in order:
        np.testing.assert_array_equal(clip.frames[number], expected[number])


@pytest.fixture
def film(tmp_path: Path) -> Path:
    return write(tmp_path / "film.mp4", "libx264", B_FRAMES)


@pytest.fixture
def decoded(monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """What reading has decoded so far; the opening is not counted."""
    frames: list[object] = []
    plain = video_frames.decoded

    def counting(*arguments: Any) -> Iterator[object]:
        for frame in plain(*arguments):
            frames.append(frame.pts)
            yield frame

    monkeypatch.setattr(video_frames, "decoded", counting)
    return frames


class TestWork:
    """Decoded once to open, once to read in order, and from the key frame before else."""

    def test_opening_keeps_cuts_and_digest_without_another_pass(self, film: Path, decoded: list[object]):
        clip = read_clip(film)
        assert find_cuts(clip.frames) == [38]
        assert clip.part(0, 38, "first").digest() != clip.digest()
        assert decoded == []

    def test_in_order_each_frame_is_decoded_once(self, film: Path, decoded: list[object]):
        clip = read_clip(film)
        for number in range(COUNT - 8):
            _ = clip.frames[number], clip.frames[number + 8]  # as flow at a gap asks for them
        assert len(decoded) == COUNT

    def test_two_readers_do_not_lead_each_other_away(self, film: Path, decoded: list[object]):
        frames = read_clip(film).frames
        assert isinstance(frames, Frames)
        ahead, beside = frames.again(), frames.again()
        for number in range(COUNT - 30):
            _ = ahead[number + 30], beside[number]
        assert len(decoded) <= 2 * COUNT
        np.testing.assert_array_equal(beside[50], frames[50])

    def test_a_frame_is_reached_from_the_key_frame_before(self, film: Path, decoded: list[object]):
        clip = read_clip(film)
        _ = clip.frames[65], clip.frames[64], clip.frames[63]
        assert len(decoded) <= 8
        _ = clip.frames[1]
        assert len(decoded) <= 8 + 2

    @pytest.mark.parametrize("form", ["a transport stream", "a transport stream of H.264", "a programme stream"])
    def test_where_the_container_leads_too_far_an_earlier_one_does(
        self, form: str, tmp_path: Path, decoded: list[object]
    ):
        name, codec, options = FORMS[form]
        clip = read_clip(write(tmp_path / name, codec, options))
        _ = clip.frames[70]
        begun = len(decoded)
        for number in (45, 71, 46, 73):
            _ = clip.frames[number]
        assert len(decoded) - begun < 4 * 30

    def test_pictures_from_the_lowest_row_up_are_found_again(self, tmp_path: Path, decoded: list[object]):
        path = lowest_row_first(tmp_path)
        with av.open(str(path)) as file:
            assert len({mark(frame) for frame in file.decode(video=0)}) == COUNT
        clip = read_clip(path)
        for number in (70, 5, 40):
            _ = clip.frames[number]
        assert len(decoded) == 3

    def test_what_was_read_last_is_not_read_again(self, film: Path, decoded: list[object]):
        frames = read_clip(film).frames
        for _ in range(3):
            _ = frames[40], frames[2:5][1], frames[41]
        assert len(decoded) < 30


def test_threads_may_ask_at_once(film: Path):
    expected, clip = list(plainly_decoded(film)), read_clip(film)
    order = list(range(COUNT))
    random.Random(1).shuffle(order)
    with ThreadPoolExecutor(4) as pool:
        for number, frame in zip(order, pool.map(clip.frames.__getitem__, order), strict=True):
            np.testing.assert_array_equal(frame, expected[number])


def open_files(path: Path) -> int:
    links = Path("/proc/self/fd")
    if not links.is_dir():
        pytest.skip("needs /proc")
    return sum(os.path.realpath(link) == str(path.resolve()) for link in links.iterdir())


def test_files_are_closed(film: Path):
    clip = read_clip(film)
    assert open_files(film) == 0
    _ = clip.frames[3]
    assert open_files(film) == 1
    for _ in clip.frames:
        pass
    assert open_files(film) == 0
    _ = clip.frames[3]
    del clip
    assert open_files(film) == 0


class TestChangedFile:
    @pytest.mark.parametrize("begun", [False, True])
    def test_vanished(self, film: Path, begun: bool):
        clip = read_clip(film)
        if begun:
            _ = clip.frames[0]
        film.unlink()
        with pytest.raises(ClipError, match=r"film\.mp4 cannot be read any more \(No such file or directory\)"):
            _ = clip.frames[40]

    @pytest.mark.parametrize("begun", [False, True])
    def test_written_to(self, film: Path, begun: bool):
        clip = read_clip(film)
        if begun:
            _ = clip.frames[0]
        write_video(film, drifting(20))
        with pytest.raises(ClipError, match=r"film\.mp4 has changed since it was opened"):
            _ = clip.frames[40]
        with pytest.raises(ClipError, match=r"film\.mp4 has changed since it was opened"):
            clip.digest()

    def test_written_to_unseen(self, film: Path):
        """In the same moment, with as many bytes: a shorter film, and some nothing behind it."""
        clip, before = read_clip(film), film.stat()
        write_video(film, drifting(20))
        film.write_bytes(film.read_bytes()[: before.st_size].ljust(before.st_size, b"\0"))
        os.utime(film, ns=(before.st_atime_ns, before.st_mtime_ns))
        with pytest.raises(ClipError, match=r"film\.mp4 has changed since it was opened"):
            _ = clip.frames[40]

    def test_the_working_folder_does_not_matter(self, film: Path, monkeypatch: pytest.MonkeyPatch):
        monkeypatch.chdir(film.parent)
        clip = read_clip(film.name)
        monkeypatch.chdir("/")
        assert clip.frames[40].shape == (60, 94, 3)


def test_without_room_for_small_pictures(film: Path, monkeypatch: pytest.MonkeyPatch):
    """Cuts are then found by reading the frames."""

    def full(**_: object) -> None:
        raise OSError("No space left on device")

    monkeypatch.setattr("decomotion.greys.TemporaryFile", full)
    assert find_cuts(read_clip(film).frames) == [38]


class TestDigest:
    def test_is_of_the_bytes_and_the_part(self, film: Path, tmp_path: Path):
        clip = read_clip(film)
        shutil.copy(film, tmp_path / "other.mp4")
        assert read_clip(tmp_path / "other.mp4").digest() == clip.digest()
        again = read_clip(tmp_path / "other.mp4")
        parts = [again.part(3, 9, "x"), read_clip(f"{tmp_path}/other.mp4@3:9"), again.part(1, 20, "y").part(2, 8, "z")]
        assert len({part.digest() for part in parts}) == 1
        others: list[Clip] = [again.part(3, 10, "x"), again.part(2, 9, "x"), again]
        assert len({clip.digest() for clip in (parts[0], *others)}) == 4
        assert read_clip(f"{tmp_path}/other.mp4@0:{COUNT}").digest() == again.digest()

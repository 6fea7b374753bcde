"""Frames on demand behave as an array of frames does where it matters, and arrays serve in their place."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from clip_files import flat_frames, write_images
from decomotion.clip import Clip, read_clip
from decomotion.data.cuts import find_cuts
from decomotion.errors import ClipError
from decomotion.frames import KEPT, Frames, Image, Source


class Counted(Source):
    """Frames of one level each; knows which were read."""

    def __init__(self, count: int = 20, height: int = 4, width: int = 6) -> None:
        self.shape = (count, height, width, 3)
        self.asked: list[int] = []

    def read(self, number: int) -> Image:
        self.asked.append(number)
        return np.full(self.shape[1:], number, np.uint8)

    def digest(self, numbers: range) -> str:
        return repr(numbers)


class TestAccess:
    def test_nothing_is_read_but_what_is_asked_for(self):
        source = Counted()
        frames = Frames(source)
        part = frames[5:15][2:4]
        assert (len(frames), frames.shape, frames.dtype, frames.ndim) == (20, (20, 4, 6, 3), np.uint8, 4)
        assert (len(part), part.shape, part.digest()) == (2, (2, 4, 6, 3), "range(7, 9)")
        assert source.asked == []
        assert [int(part[number][0, 0, 0]) for number in (0, -1, np.int64(1))] == [7, 8, 8]
        assert source.asked == [7, 8]

    def test_iteration_is_in_order(self):
        source = Counted(5)
        assert [int(frame[0, 0, 0]) for frame in Frames(source)[1:]] == [1, 2, 3, 4]
        assert source.asked == [1, 2, 3, 4]

    def test_the_last_ones_are_kept_and_shared_with_parts(self):
        source = Counted()
        frames = Frames(source)
        for _ in range(2):
            _ = frames[3], frames[2:6][1], frames[9]
        assert source.asked == [3, 9]
        for number in range(10, 10 + KEPT):
            _ = frames[number]
        _ = frames[3]
        assert source.asked[-1] == 3

    def test_of_another_reader_none_is_kept(self):
        source = Counted()
        frames = Frames(source)[5:15]
        assert [int(frames.again()[number][0, 0, 0]) for number in (0, -1)] == [5, 14]
        again = frames.again()[1:]
        _ = again[0], again[0], frames[1], frames[1]
        assert source.asked == [5, 14, 6, 6, 6]

    def test_what_is_kept_cannot_be_written_to(self):
        with pytest.raises(ValueError, match="read-only"):
            Frames(Counted())[0][0] = 1

    @pytest.mark.parametrize("number", [5, -6])
    def test_there_are_no_others(self, number: int):
        with pytest.raises(IndexError):
            _ = Frames(Counted())[:5][number]

    def test_a_short_clip_as_an_array(self):
        frames = Frames(Counted(3))
        np.testing.assert_array_equal(np.asarray(frames)[:, 0, 0, 0], [0, 1, 2])
        assert np.asarray(frames[1:], np.float32).dtype == np.float32
        with pytest.raises(ValueError, match="no array"):
            np.asarray(frames, copy=False)

    def test_large_ones_are_kept_only_as_they_fit(self):
        source = Counted(count=30, height=2160, width=3840)
        tracemalloc.start()
        try:
            for _ in Frames(source):
                pass
            assert tracemalloc.get_traced_memory()[1] < 4 * 2160 * 3840 * 3  # two, and one that is being made
        finally:
            tracemalloc.stop()


class TestArrays:
    frames = flat_frames([1, 2, 3, 4])

    def test_a_part_is_a_view(self):
        assert np.shares_memory(Clip("goat", self.frames).part(1, 3, "x").frames, self.frames)

    def test_mapped_from_a_file(self, tmp_path: Path):
        np.save(tmp_path / "frames.npy", self.frames)
        mapped = np.load(tmp_path / "frames.npy", mmap_mode="r")
        clip = Clip("goat", mapped)
        assert (clip.height, clip.width, len(clip.part(1, 3, "x"))) == (16, 24, 2)
        assert clip.digest() == Clip("goat", self.frames).digest()


class TestFolder:
    def test_parts_are_views_and_have_digests_of_their_own(self, tmp_path: Path):
        frames = flat_frames([1, 2, 3, 4])
        folder = write_images(tmp_path / "a", [f"{number}.png" for number in range(4)], frames)
        other = write_images(tmp_path / "b", ["7.png", "8.png"], frames[1:3])
        clip = read_clip(folder)
        parts = [clip.part(1, 3, "x"), read_clip(f"{folder}@1:3"), read_clip(other)]
        np.testing.assert_array_equal(parts[0].frames, frames[1:3])
        assert {part.digest() for part in parts} == {parts[0].digest()}
        assert len({part.digest() for part in (parts[0], clip, clip.part(0, 2, "x"), clip.part(1, 4, "x"))}) == 4

    def test_no_frame_is_decoded_to_open_it(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
        for suffix in ("png", "jpg"):
            names = [f"{number}.{suffix}" for number in range(3)]
            write_images(tmp_path / suffix, names, flat_frames([1, 2, 3], height=7, width=10))
        monkeypatch.setattr("decomotion.frame_files.decode_frame", None)
        for suffix in ("png", "jpg"):
            assert read_clip(tmp_path / suffix).frames.shape == (3, 7, 10, 3)

    def test_damage_that_headers_do_not_tell_is_one_sentence_when_asked_for(self, tmp_path: Path):
        folder = write_images(tmp_path, [f"{number}.png" for number in range(3)], flat_frames([1, 2, 3]))
        content = bytearray((folder / "1.png").read_bytes())
        content[60:80] = bytes(20)
        (folder / "1.png").write_bytes(content)
        clip = read_clip(folder)
        _ = clip.frames[0]
        with pytest.raises(ClipError, match=r"1\.png does not decode as an image; replace it or remove it"):
            _ = clip.frames[1]

    @pytest.mark.parametrize("suffix", [".png", ".jpg"])
    def test_changed_or_vanished(self, suffix: str, tmp_path: Path):
        folder = write_images(tmp_path, [f"{number}{suffix}" for number in range(3)], flat_frames([1, 2, 3]))
        clip = read_clip(folder)
        write_images(folder, [f"1{suffix}"], flat_frames([9], height=30))
        (folder / f"2{suffix}").unlink()
        for read in (lambda: clip.frames[1], lambda: find_cuts(clip.frames[1:]), clip.digest):
            with pytest.raises(ClipError, match=r"1\..* has changed since it was opened; leave it as it is"):
                read()
        with pytest.raises(ClipError, match=r"2\..* cannot be read any more \(No such file or directory\)"):
            _ = clip.frames[2]

    def test_the_working_folder_does_not_matter(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
        write_images(tmp_path / "goat", ["0.png", "1.png"], flat_frames([1, 2]))
        monkeypatch.chdir(tmp_path)
        clip = read_clip("goat")
        monkeypatch.chdir("/")
        assert clip.frames[1][0, 0, 0] == 2

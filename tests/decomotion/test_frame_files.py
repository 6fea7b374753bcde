"""Clips from folders: which files, in which order, and one clear sentence for what cannot be read."""

from __future__ import annotations

import os
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from clip_files import flat_frames, shown_by_exif, turned_jpeg, write_images
from decomotion.clip import read_clip
from decomotion.errors import ClipError
from decomotion.frame_files import decode_frame, decode_mask, decode_rgba

LYING = (0x112, 3, 1, 6, 0)
"""Tag, kind, count, value and what fills up of an orientation by a quarter turn."""
DAMAGED_EXIF: dict[str, list[bytes]] = {
    "another number": [struct.pack(">HHHIHH", 1, 0x112, 3, 1, 9, 0)],
    "a kind of one byte": [struct.pack(">HHHIHH", 1, 0x112, 1, 1, 6 << 8, 0)],
    "a kind of four bytes": [struct.pack(">HHHII", 1, 0x112, 4, 1, 6)],
    "cut short": [struct.pack(">HHHI", 1, 0x112, 3, 1)],
    "a directory without an end": [struct.pack(">H", 40)],
    "no order of bytes": [struct.pack(">HHHIHH", 1, *LYING), b"XX"],
    "twice": [struct.pack(">HHHIHH", 1, *LYING), b"MM", struct.pack(">HHHIHH", 1, 0x112, 3, 1, 1, 0)],
    "twice, the other way round": [
        struct.pack(">HHHIHH", 1, 0x112, 3, 1, 1, 0),
        b"MM",
        struct.pack(">HHHIHH", 1, *LYING),
    ],
}
"""Its first directory, the order of bytes, and that of a second EXIF."""


def with_exif(
    frame: npt.NDArray[np.uint8], directory: bytes, order: bytes = b"MM", second: bytes | None = None
) -> bytes:
    """A JPEG of the frame [H, W, 3] with EXIF of those parts."""
    content = cv2.imencode(".jpg", frame)[1].tobytes()
    for each in (second, directory):
        if each is not None:
            exif = b"Exif\0\0" + order + b"\0*" + struct.pack(">I", 8) + each + bytes(4)
            content = content[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + content[2:]
    return content


class TestFolder:
    def test_frames_come_in_natural_order(self, tmp_path: Path):
        levels = [10, 90, 2, 1, 100]
        folder = write_images(tmp_path, [f"frame{level}.png" for level in levels], flat_frames(levels))
        assert np.asarray(read_clip(folder).frames)[:, 0, 0, 0].tolist() == [1, 2, 10, 90, 100]

    @pytest.mark.parametrize(
        "names",
        [
            ["1.png", "2.png", "10.png"],
            ["a1b2.png", "a1b10.png", "a2b1.png"],
            ["0.png", "00.png", "01.png"],  # two equal as numbers: by name, on every file system
            ["2²1.png", "2²2.png", "3²1.png"],  # a superscript is no digit of a number
            ["7.png", "frame.png", "frame1.png"],
        ],
    )
    def test_order_of(self, names: list[str], tmp_path: Path):
        write_images(tmp_path, names[::-1], flat_frames([2, 1, 0]))
        assert np.asarray(read_clip(tmp_path).frames)[:, 0, 0, 0].tolist() == [0, 1, 2]

    def test_frames_are_rgb_of_the_files(self, tmp_path: Path):
        frames = flat_frames([10, 200], height=5, width=7)
        clip = read_clip(write_images(tmp_path / "goat", ["0.png", "1.png"], frames))
        np.testing.assert_array_equal(clip.frames, frames)
        assert (clip.name, len(clip), clip.height, clip.width, clip.fps) == ("goat", 2, 5, 7, 24.0)

    def test_omnimotion_layout(self, tmp_path: Path):
        write_images(tmp_path / "goat" / "color", ["0.png", "1.png"], flat_frames([1, 2]))
        (tmp_path / "goat" / "flows").mkdir()
        clip = read_clip(tmp_path / "goat")
        assert (clip.name, len(clip)) == ("goat", 2)

    @pytest.mark.parametrize("inner", ["color", "clip", "frames", "clip/color"])
    def test_named_after_the_video_not_the_kind_of_folder(self, inner: str, tmp_path: Path):
        folder = write_images(tmp_path / "goat" / inner, ["0.png", "1.png"], flat_frames([1, 2]))
        assert read_clip(folder).name == "goat"

    def test_named_where_the_path_is_relative(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
        monkeypatch.chdir(write_images(tmp_path / "goat", ["0.png", "1.png"], flat_frames([1, 2])))
        assert read_clip(".").name == "goat"

    def test_suffixes_in_any_case_and_other_files_left_alone(self, tmp_path: Path):
        write_images(tmp_path, ["0.JPG", "1.Jpeg", "2.PNG", "3.png"], flat_frames([0, 60, 120, 180]))
        (tmp_path / "notes.txt").write_text("shot in the morning")
        (tmp_path / "._0.jpg").write_bytes(b"what macOS leaves beside a copied file")
        levels = np.asarray(read_clip(tmp_path).frames)[:, 0, 0, 0].astype(int)
        assert np.abs(levels - [0, 60, 120, 180]).max() <= 8  # what JPEG loses on these frames

    def test_grey_alpha_and_16_bit_images_become_rgb(self, tmp_path: Path):
        cv2.imwrite(str(tmp_path / "0.png"), np.full((4, 6), 77, np.uint8))
        cv2.imwrite(str(tmp_path / "1.png"), np.full((4, 6, 4), 77, np.uint8))
        cv2.imwrite(str(tmp_path / "2.png"), np.full((4, 6, 3), 77 * 257, np.uint16))
        np.testing.assert_array_equal(read_clip(tmp_path).frames, np.full((3, 4, 6, 3), 77))

    def test_no_frames(self, tmp_path: Path):
        with pytest.raises(ClipError, match=r"holds no frames; put \.jpg or \.png files there, or in .*color"):
            read_clip(tmp_path)

    def test_absent(self, tmp_path: Path):
        with pytest.raises(ClipError, match="nowhere does not exist"):
            read_clip(tmp_path / "nowhere")

    def test_one_frame(self, tmp_path: Path):
        with pytest.raises(ClipError, match="one frame; motion needs at least two"):
            read_clip(write_images(tmp_path, ["0.png"], flat_frames([1])))

    def test_mixed_sizes_names_both_frames(self, tmp_path: Path):
        write_images(tmp_path, ["0.png", "1.png"], flat_frames([1, 2], height=16, width=24))
        write_images(tmp_path, ["2.png"], flat_frames([3], height=8, width=12))
        with pytest.raises(ClipError, match=r"2\.png is 12x8 but 0\.png is 24x16"):
            read_clip(tmp_path)

    @pytest.mark.parametrize("damage", ["truncated", "empty", "text"])
    @pytest.mark.parametrize("suffix", [".jpg", ".png"])
    def test_undecodable_frame_is_named(self, suffix: str, damage: str, tmp_path: Path, capfd: pytest.CaptureFixture):
        write_images(tmp_path, [f"{i}{suffix}" for i in range(3)], flat_frames([1, 2, 3]))
        bad = tmp_path / f"1{suffix}"
        whole = bad.read_bytes()
        bad.write_bytes({"truncated": whole[: len(whole) // 2], "empty": b"", "text": b"not an image"}[damage])
        with pytest.raises(ClipError, match=rf"1\{suffix} does not decode as an image"):
            read_clip(tmp_path)

    def test_unreadable_frame_is_named(self, tmp_path: Path):
        write_images(tmp_path, ["0.png", "1.png"], flat_frames([1, 2]))
        (tmp_path / "2.png").symlink_to(tmp_path / "gone.png")
        with pytest.raises(ClipError, match=r"2\.png cannot be read \(No such file or directory\)"):
            read_clip(tmp_path)

    def test_frames_and_their_masks_are_two_clips(self, tmp_path: Path):
        names = [f"{number:03d}{suffix}" for number in range(3) for suffix in (".jpg", ".png")]
        write_images(tmp_path, names, flat_frames([1, 2, 3, 4, 5, 6]))
        with pytest.raises(ClipError, match=rf"in {tmp_path}, 000\.jpg and 000\.png differ in their ending alone"):
            read_clip(tmp_path)

    def test_jpg_and_png_that_continue_each_other(self, tmp_path: Path):
        write_images(tmp_path, ["0.jpg", "1.png", "2.jpg"], flat_frames([0, 100, 200]))
        assert np.round(np.asarray(read_clip(tmp_path).frames)[:, 0, 0, 0] / 100).tolist() == [0, 1, 2]

    def test_frames_in_both_folders_are_two_clips(self, tmp_path: Path):
        for folder in (tmp_path, tmp_path / "color"):
            write_images(folder, ["0.png", "1.png"], flat_frames([1, 2]))
        with pytest.raises(ClipError, match=r"holds frames, and so does .*color; give one of the two"):
            read_clip(tmp_path)

    @pytest.mark.parametrize("names", [["0.5.png", "2.0.png", "10.25.png"], ["-10.png", "-2.png", "1.png"]])
    def test_numbers_are_in_their_order(self, names: list[str], tmp_path: Path):
        write_images(tmp_path, names[::-1], flat_frames([2, 1, 0]))
        assert np.asarray(read_clip(tmp_path).frames)[:, 0, 0, 0].tolist() == [0, 1, 2]

    @pytest.mark.parametrize("orientation", range(1, 9))
    def test_exif_turns_a_frame(self, orientation: int, tmp_path: Path):
        frames = flat_frames([20, 200])
        frames[:, :8, :, 2] = 250
        for number, frame in enumerate(frames):
            (tmp_path / f"{number}.jpg").write_bytes(turned_jpeg(frame, orientation))
        shown = [shown_by_exif(frame, orientation) for frame in frames]
        # what JPEG loses on these; another orientation differs by 50 and more
        assert np.abs(np.asarray(read_clip(tmp_path).frames).astype(int) - shown).mean() < 8

    @pytest.mark.parametrize("exif", DAMAGED_EXIF)
    def test_exif_that_says_nothing_clear(self, exif: str, tmp_path: Path):
        """Whether it turns the frame or not, the frame is as large as it was at the opening."""
        for number in range(2):
            (tmp_path / f"{number}.jpg").write_bytes(with_exif(flat_frames([90])[0], *DAMAGED_EXIF[exif]))
        clip = read_clip(tmp_path)
        assert clip.frames[1].shape == clip.frames.shape[1:]
        assert sorted(clip.frames.shape[1:3]) == [16, 24]

    @pytest.mark.parametrize("exif", ["another number", "a directory without an end"])
    def test_exif_that_says_nothing_turns_nothing(self, exif: str, tmp_path: Path):
        for number in range(2):
            (tmp_path / f"{number}.jpg").write_bytes(with_exif(flat_frames([90])[0], *DAMAGED_EXIF[exif]))
        assert read_clip(tmp_path).frames.shape == (2, 16, 24, 3)

    def test_bytes_that_fill_up_before_a_marker(self, tmp_path: Path):
        for number, frame in enumerate(flat_frames([90, 120])):
            content = cv2.imencode(".jpg", frame)[1].tobytes()
            (tmp_path / f"{number}.jpg").write_bytes(content[:2] + b"\xff\xff" + content[2:])
        assert read_clip(tmp_path).frames[1].shape == (16, 24, 3)

    @pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no named pipes")
    def test_a_pipe_among_frames_is_not_waited_for(self, tmp_path: Path):
        write_images(tmp_path, ["0.png", "1.png"], flat_frames([1, 2]))
        os.mkfifo(tmp_path / "2.png")
        with pytest.raises(ClipError, match=r"frame .*2\.png is a pipe or a device; replace it"):
            read_clip(tmp_path)


class TestTransparent:
    """Pictures with alpha lie as others do."""

    @pytest.mark.parametrize("orientation", range(1, 9))
    def test_turned_as_what_is_opaque(self, orientation: int):
        picture = np.random.default_rng(0).integers(0, 256, (10, 14, 4), np.uint8)
        picture[..., 3] = 255 * (picture[..., 3] > 90)
        content = cv2.imencode(".png", cv2.cvtColor(picture, cv2.COLOR_RGBA2BGRA))[1].tobytes()
        exif = b"MM\0*" + struct.pack(">IHHHIHHI", 8, 1, 0x112, 3, 1, orientation, 0, 0)
        chunk = struct.pack(">I", len(exif)) + b"eXIf" + exif + struct.pack(">I", zlib.crc32(b"eXIf" + exif))
        content = content[:33] + chunk + content[33:]  # behind the header
        shown = shown_by_exif(picture, orientation)
        colours, whole = decode_frame(content), decode_rgba(content)
        np.testing.assert_array_equal(colours, shown[..., :3])
        np.testing.assert_array_equal(whole, shown)
        np.testing.assert_array_equal(decode_mask(content, ".png"), shown[..., 3] > 0)


class TestDepth:
    """Files of 16 bits whose values need fewer."""

    def write(self, folder: Path, values: npt.ArrayLike, first: int = 0) -> Path:
        for number, value in enumerate(np.asarray(values), first):
            cv2.imwrite(str(folder / f"{number}.png"), np.full((8, 12, 3), value, np.uint16))
        return folder

    @pytest.mark.parametrize("bits", [8, 10, 12, 14])
    def test_values_are_scaled_as_they_need(self, bits: int, tmp_path: Path, caplog: pytest.LogCaptureFixture):
        values = np.array([0, 30, 120, 255]) << (bits - 8)
        clip = read_clip(self.write(tmp_path, values))
        assert np.asarray(clip.frames)[:, 0, 0].tolist() == [[level] * 3 for level in (0, 30, 120, 255)]
        assert caplog.messages == [f"the values in {tmp_path} need {bits} of 16 bits and are scaled as such"]

    def test_all_16_are_kept(self, tmp_path: Path, caplog: pytest.LogCaptureFixture):
        clip = read_clip(self.write(tmp_path, [0, 30 * 257, 65535]))
        assert np.asarray(clip.frames)[:, 0, 0, 0].tolist() == [0, 30, 255]
        assert caplog.messages == []

    def test_one_scale_for_the_clip(self, tmp_path: Path):
        """A dark frame stays dark, also where the bright ones are not asked for, and beside files of 8 bits."""
        self.write(tmp_path, [100, 200, 4000])
        assert np.asarray(read_clip(tmp_path).frames)[:, 0, 0, 0].tolist() == [6, 12, 250]
        assert np.asarray(read_clip(f"{tmp_path}@0:2").frames)[:, 0, 0, 0].tolist() == [6, 12]
        cv2.imwrite(str(tmp_path / "3.png"), np.full((8, 12, 3), 77, np.uint8))
        assert np.asarray(read_clip(tmp_path).frames)[:, 0, 0, 0].tolist() == [6, 12, 250, 77]

    def test_the_scale_makes_another_clip(self, tmp_path: Path):
        """The same files, with other frames: beside brighter ones, which are not asked for."""
        alone = read_clip(f"{self.write(tmp_path, [100, 200, 300])}@0:2").digest()
        assert read_clip(f"{self.write(tmp_path, [4000], first=2)}@0:2").digest() != alone

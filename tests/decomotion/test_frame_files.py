"""Clips from folders: which files, in which order, and one clear sentence for what cannot be read."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from clip_files import flat_frames, write_images
from decomotion.clip import read_clip
from decomotion.errors import ClipError


class TestFolder:
    def test_frames_come_in_natural_order(self, tmp_path: Path):
        levels = [10, 90, 2, 1, 100]
        folder = write_images(tmp_path, [f"frame{level}.png" for level in levels], flat_frames(levels))
        assert read_clip(folder).frames[:, 0, 0, 0].tolist() == [1, 2, 10, 90, 100]

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
        assert read_clip(tmp_path).frames[:, 0, 0, 0].tolist() == [0, 1, 2]

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
        levels = read_clip(tmp_path).frames[:, 0, 0, 0].astype(int)
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

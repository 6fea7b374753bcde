"""Reading clips: order, names, and one clear sentence for everything that cannot be read."""

from __future__ import annotations

import dataclasses
import shutil
import struct
from collections.abc import Sequence
from pathlib import Path

import av
import cv2
import numpy as np
import numpy.typing as npt
import pytest

from decomotion.clip import Clip, read_clip
from decomotion.errors import ClipError

Frames = npt.NDArray[np.uint8]


def flat_frames(levels: Sequence[int], height: int = 16, width: int = 24) -> Frames:
    """One frame for each level, [T, H, W, 3]: the level in red, a left-to-right ramp in green, nothing in blue."""
    frames = np.zeros((len(levels), height, width, 3), np.uint8)
    frames[..., 0] = np.array(levels)[:, None, None]
    frames[..., 1] = np.arange(width) * 200 // width
    return frames


def write_images(folder: Path, names: Sequence[str], frames: Frames) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for name, frame in zip(names, frames, strict=True):
        encoded = cv2.imencode(Path(name).suffix.lower(), cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))[1]
        (folder / name).write_bytes(encoded.tobytes())
    return folder


def write_video(path: Path, frames: Frames, fps: int = 12) -> Path:
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=fps, options={"crf": "8"})
        stream.height, stream.width, stream.pix_fmt = frames.shape[1], frames.shape[2], "yuv420p"
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())
    return path


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


class TestVideo:
    def test_round_trip(self, tmp_path: Path):
        frames = flat_frames([20, 60, 100, 140, 180], height=32, width=48)
        clip = read_clip(write_video(tmp_path / "goat.mp4", frames, fps=12))
        assert (clip.name, clip.fps, clip.frames.shape, clip.frames.dtype) == ("goat", 12.0, frames.shape, np.uint8)
        # H.264 at this quality, and red at half resolution: a few levels
        assert np.abs(clip.frames.astype(int) - frames).mean() < 4

    def test_suffix_in_upper_case(self, tmp_path: Path):
        written = write_video(tmp_path / "goat.mp4", flat_frames([20, 60], height=32, width=48))
        assert len(read_clip(written.rename(tmp_path / "GOAT.MP4"))) == 2

    @pytest.mark.parametrize(
        ("quarter_turns", "matrix"),
        [
            (-1, (0, 1, -1, 0)),
            (1, (0, -1, 1, 0)),
            (2, (-1, 0, 0, -1)),
        ],
    )
    def test_rotation_beside_the_video_is_applied(
        self, quarter_turns: int, matrix: tuple[int, int, int, int], tmp_path: Path
    ):
        """A phone's portrait video is stored lying down, under a display matrix in the mp4's track header."""
        path = write_video(tmp_path / "lying.mp4", flat_frames([20, 60], height=32, width=48))
        lying = read_clip(path).frames
        content = bytearray(path.read_bytes())
        a, b, c, d = (value << 16 for value in matrix)
        struct.pack_into(">9i", content, content.index(b"tkhd") + 44, a, b, 0, c, d, 0, 0, 0, 1 << 30)
        path.write_bytes(content)
        np.testing.assert_array_equal(read_clip(path).frames, np.rot90(lying, quarter_turns, axes=(1, 2)))

    def test_truncated(self, tmp_path: Path):
        path = write_video(tmp_path / "cut.mp4", flat_frames([20, 60], height=32, width=48))
        path.write_bytes(path.read_bytes()[:-200])
        with pytest.raises(ClipError, match=r"cut\.mp4 does not decode as a video \(.+\)"):
            read_clip(path)

    def test_damaged_in_the_middle(self, tmp_path: Path):
        path = write_video(tmp_path / "bad.mp4", flat_frames(range(0, 200, 10), height=32, width=48))
        content = bytearray(path.read_bytes())
        start = content.index(b"mdat") + 4
        content[start + 700 : start + 1100] = b"\xff" * 400
        path.write_bytes(content)
        with pytest.raises(ClipError, match=r"bad\.mp4 does not decode as a video"):
            read_clip(path)

    def test_frame_size_changes_on_the_way(self, tmp_path: Path):
        parts = [
            write_video(tmp_path / f"{height}.h264", flat_frames([20, 60], height, width=48)) for height in (32, 64)
        ]
        joined = tmp_path / "joined.h264"
        joined.write_bytes(b"".join(part.read_bytes() for part in parts))
        with pytest.raises(ClipError, match=r"joined\.h264 changes its frame size on the way"):
            read_clip(joined)

    def test_not_a_video(self, tmp_path: Path):
        (tmp_path / "film.mp4").write_bytes(b"not a film at all" * 20)
        with pytest.raises(ClipError, match=r"film\.mp4 does not decode as a video"):
            read_clip(tmp_path / "film.mp4")

    def test_one_image_is_one_frame(self, tmp_path: Path):
        write_images(tmp_path, ["0.png"], flat_frames([1]))
        with pytest.raises(ClipError, match="one frame"):
            read_clip(tmp_path / "0.png")

    def test_sound_without_picture(self, tmp_path: Path):
        with av.open(str(tmp_path / "song.wav"), "w") as container:
            stream = container.add_stream("pcm_s16le", rate=8000, layout="mono")
            sound = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), format="s16", layout="mono")
            sound.sample_rate = 8000
            container.mux(stream.encode(sound))
        with pytest.raises(ClipError, match=r"song\.wav has no video stream"):
            read_clip(tmp_path / "song.wav")

    def test_real_clip(self, shared: Path):
        clip = read_clip(shared / "data" / "clips" / "cat.mp4")
        assert clip.name == "cat"
        assert len(clip) > 10
        assert clip.frames.std() > 10


class TestTimes:
    frames = flat_frames([1, 2, 3, 4])

    def test_of_an_even_rate(self):
        clip = Clip("goat", self.frames, 12.5)
        np.testing.assert_allclose(clip.times, [0, 0.08, 0.16, 0.24])
        assert (clip.times.dtype, clip.fps, clip.variable_rate, clip.pixel_aspect) == (np.float64, 12.5, False, 1.0)

    @pytest.mark.parametrize("rate", [24.0, 25.0, 12.0, 7.3, 1 / 3600, 240.0])
    @pytest.mark.parametrize("length", [2, 3, 97])
    def test_the_rate_is_that_of_the_times(self, rate: float, length: int):
        assert Clip("goat", np.zeros((length, 2, 3, 3), np.uint8), rate).fps == pytest.approx(rate, rel=1e-11)

    def test_without_a_rate_it_is_24(self):
        assert Clip("goat", self.frames).fps == 24.0
        assert Clip("goat", self.frames[:1]).fps == 24.0

    def test_the_rate_is_the_mean_over_the_clip(self):
        clip = Clip("goat", self.frames, times=[0, 0.1, 0.2, 0.6])
        assert (clip.fps, clip.variable_rate) == (5.0, True)

    @pytest.mark.parametrize("rate", [24, 30, 60, 240])
    def test_whole_milliseconds_make_no_variable_rate(self, rate: int):
        times = np.round(np.arange(100) * 1000 / rate) / 1000
        clip = Clip("goat", np.zeros((100, 2, 3, 3), np.uint8), times=times)
        assert not clip.variable_rate
        kept = np.delete(np.arange(100), 50)
        assert Clip("goat", clip.frames[kept], times=times[kept]).variable_rate

    def test_a_part_has_its_own_from_zero(self):
        clip = Clip("goat", self.frames, times=[0, 0.1, 0.3, 0.6], pixel_aspect=4 / 3)
        part = clip.part(1, 4, "late")
        np.testing.assert_allclose(part.times, [0, 0.2, 0.5])
        assert (part.name, part.pixel_aspect) == ("goat-late", 4 / 3)

    @pytest.mark.parametrize("times", [[0, 1, 2], [0, 1, 1, 2], [0, 2, 1, 3], [1, 2, 3, 4], [0, 1, 2, np.nan]])
    def test_others_are_a_mistake(self, times: list[float]):
        with pytest.raises(ValueError, match="as many increasing times"):
            Clip("goat", self.frames, times=times)

    def test_a_rate_and_times_are_a_mistake(self):
        with pytest.raises(TypeError, match="not both"):
            Clip("goat", self.frames, 24.0, times=[0, 1, 2, 3])


class TestDigest:
    frames = flat_frames([1, 2, 3])

    def test_is_the_same_on_every_machine_and_day(self):
        assert Clip("goat", self.frames, 24.0).digest() == "c730763c9e21d62a"

    def test_depends_on_content_alone(self, tmp_path: Path):
        clip = Clip("goat", self.frames, 24.0)
        assert dataclasses.replace(clip, name="dog", times=clip.times * 2).digest() == clip.digest()
        assert Clip("goat", np.asfortranarray(self.frames), 24.0).digest() == clip.digest()
        write_images(tmp_path / "a", ["0.png", "1.png", "2.png"], self.frames)
        shutil.copytree(tmp_path / "a", tmp_path / "b")
        assert read_clip(tmp_path / "a").digest() == read_clip(tmp_path / "b").digest() == clip.digest()

    def test_changes_with_one_value_the_order_or_the_shape(self):
        one_value = self.frames.copy()
        one_value[-1, -1, -1, -1] ^= 1
        other = [one_value, self.frames[::-1], self.frames[:-1], self.frames.reshape(3, 24, 16, 3)]
        digests = {Clip("goat", frames, 24.0).digest() for frames in [self.frames, *other]}
        assert len(digests) == 1 + len(other)

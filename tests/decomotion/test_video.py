"""Clips from video files, whole and damaged."""

from __future__ import annotations

import logging
import os
import shutil
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import numpy.typing as npt
import pytest

from clip_files import (
    flat_frames,
    shown_by_exif,
    turned_jpeg,
    with_display_matrix,
    write_images,
    write_jpegs,
    write_streams,
    write_video,
)
from decomotion.clip import read_clip
from decomotion.errors import ClipError
from films import grey_and_alpha_exr


class TestVideo:
    def test_round_trip(self, tmp_path: Path):
        frames = flat_frames([20, 60, 100, 140, 180], height=32, width=48)
        clip = read_clip(write_video(tmp_path / "goat.mp4", frames, fps=12))
        assert (clip.name, clip.fps, clip.frames.shape, clip.frames.dtype) == ("goat", 12.0, frames.shape, np.uint8)
        # H.264 at this quality, and red at half resolution: a few levels
        assert np.abs(np.asarray(clip.frames).astype(int) - frames).mean() < 4

    def test_suffix_in_upper_case(self, tmp_path: Path):
        written = write_video(tmp_path / "goat.mp4", flat_frames([20, 60], height=32, width=48))
        assert len(read_clip(written.rename(tmp_path / "GOAT.MP4"))) == 2

    def test_truncated(self, tmp_path: Path):
        path = write_video(tmp_path / "cut.mp4", flat_frames([20, 60], height=32, width=48))
        path.write_bytes(path.read_bytes()[:-200])
        with pytest.raises(ClipError, match=r"cut\.mp4 does not decode as a video \(.+\)"):
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

    @pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no named pipes")
    def test_a_pipe_is_not_waited_for(self, tmp_path: Path):
        os.mkfifo(tmp_path / "film.mp4")
        with pytest.raises(ClipError, match=r"film.mp4 is a pipe or a device, and a clip is read more than once"):
            read_clip(tmp_path / "film.mp4")

    def test_pixels_that_cannot_be_converted(self, tmp_path: Path):
        """Two to a byte, in a container that has them."""
        with av.open(str(tmp_path / "film.nut"), "w") as file:
            stream = file.add_stream("rawvideo", rate=12)
            stream.height, stream.width, stream.pix_fmt = 10, 16, "rgb4"
            for number in range(3):
                packet = av.Packet(bytes([number]) * 80)
                packet.stream, packet.time_base, packet.is_keyframe = stream, Fraction(1, 12), True
                packet.pts = packet.dts = number
                file.mux(packet)
        with pytest.raises(ClipError, match=r"film\.nut does not decode as a video \(.+\); give"):
            read_clip(tmp_path / "film.nut")

    def test_pixels_at_which_ffmpeg_ends_the_process(self, tmp_path: Path):
        """OpenEXR with grey and alpha in floats. In a process of its own, as that would end with it."""
        with av.open(str(tmp_path / "film.mov"), "w") as file:
            stream = file.add_stream("exr", rate=12)
            stream.height, stream.width, stream.pix_fmt = 12, 20, "grayf32le"
            for number in range(3):
                packet = av.Packet(grey_and_alpha_exr(12, 20))
                packet.stream, packet.time_base, packet.is_keyframe = stream, Fraction(1, 12), True
                packet.pts = packet.dts = number
                file.mux(packet)
        asked = ["-m", "decomotion.entry", "train", str(tmp_path / "film.mov"), "--out", str(tmp_path / "run")]
        done = subprocess.run([sys.executable, *asked], capture_output=True, text=True, timeout=120)
        assert done.returncode == 2, done.stderr
        assert "film.mov has pixels (yaf32le) that FFmpeg cannot convert; save it without alpha" in done.stderr
        assert not (tmp_path / "run").exists()

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
        assert np.asarray(clip.frames).std() > 10


ORIENTATIONS = {
    "as stored": ((1, 0, 0, 1), lambda frame: frame),
    "a quarter clockwise": ((0, 1, -1, 0), lambda frame: np.rot90(frame, -1)),
    "a quarter counter-clockwise": ((0, -1, 1, 0), lambda frame: np.rot90(frame, 1)),
    "half a turn": ((-1, 0, 0, -1), lambda frame: np.rot90(frame, 2)),
    "left and right exchanged": ((-1, 0, 0, 1), lambda frame: frame[:, ::-1]),
    "upside down": ((1, 0, 0, -1), lambda frame: frame[::-1]),
    "transposed": ((0, 1, 1, 0), lambda frame: frame.swapaxes(0, 1)),
    "transposed at the other diagonal": ((0, -1, -1, 0), lambda frame: np.rot90(frame, 2).swapaxes(0, 1)),
}


def corner_frames(height: int = 32, width: int = 48) -> npt.NDArray[np.uint8]:
    """Three frames whose every quarter looks otherwise."""
    frames = flat_frames([20, 60, 100], height, width)
    frames[:, : height // 2, : width // 2, 2] = 220
    frames[:, height // 2 :, : width // 2] //= 3
    return frames


class TestOrientation:
    @pytest.mark.parametrize("name", ORIENTATIONS)
    def test_frames_are_as_a_player_shows_them(self, name: str, tmp_path: Path):
        matrix, shown = ORIENTATIONS[name]
        path = write_video(tmp_path / "lying.mp4", corner_frames())
        stored = np.asarray(read_clip(path).frames)
        clip = read_clip(with_display_matrix(path, matrix))
        np.testing.assert_array_equal(clip.frames, np.stack([shown(frame) for frame in stored]))

    @pytest.mark.parametrize("name", ORIENTATIONS)
    def test_ffmpeg_shows_the_same(self, name: str, tmp_path: Path):
        if (ffmpeg := shutil.which("ffmpeg")) is None:
            pytest.skip("needs the program ffmpeg: apt-get install ffmpeg")
        path = with_display_matrix(write_video(tmp_path / "lying.mp4", corner_frames()), ORIENTATIONS[name][0])
        clip = read_clip(path)
        command = [ffmpeg, "-v", "error", "-i", str(path), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
        shown = subprocess.run(command, capture_output=True, check=True, timeout=60, stdin=subprocess.DEVNULL).stdout
        expected = np.frombuffer(shown, np.uint8).reshape(clip.frames.shape)
        # ffmpeg turns before it makes RGB of what has half the resolution in colour
        assert np.abs(np.asarray(clip.frames).astype(int) - expected).mean() < 3

    @pytest.mark.parametrize("orientation", [1, 5, 6])
    @pytest.mark.parametrize("suffix", [".avi", ".mov", ".mkv"])
    def test_cameras_of_jpegs_write_exif(self, orientation: int, suffix: str, tmp_path: Path):
        frames = corner_frames()
        files = [turned_jpeg(frame, orientation) for frame in frames]
        clip = read_clip(write_jpegs(tmp_path / f"film{suffix}", files, frames.shape[1:3]))
        turned = av.library_versions["libavcodec"] >= (62,)  # from where on FFmpeg does
        expected = [shown_by_exif(frame, orientation if turned else 1) for frame in frames]
        assert clip.frames.shape == np.shape(expected)
        assert np.abs(np.asarray(clip.frames).astype(int) - expected).mean() < 3  # half the resolution in colour

    def test_one_photo_is_one_frame(self, tmp_path: Path):
        (photo := tmp_path / "photo.jpg").write_bytes(turned_jpeg(corner_frames()[0], 6))
        with pytest.raises(ClipError, match=r"photo.jpg has one frame"):
            read_clip(photo)

    @pytest.mark.parametrize(("name", "expected"), [("as stored", 4 / 3), ("upside down", 4 / 3), ("transposed", 0.75)])
    def test_pixels_turn_with_the_frame(
        self, name: str, expected: float, tmp_path: Path, caplog: pytest.LogCaptureFixture
    ):
        path = write_video(tmp_path / "wide.mp4", corner_frames(), pixel_aspect=Fraction(4, 3))
        with caplog.at_level(logging.INFO, "decomotion"):
            clip = read_clip(with_display_matrix(path, ORIENTATIONS[name][0]))
        assert clip.pixel_aspect == pytest.approx(expected)
        assert clip.part(1, 3, "end").pixel_aspect == clip.pixel_aspect
        size = f"{clip.width}x{clip.height}"
        assert caplog.messages == [
            f"wide has pixels {expected:.4g} times as wide as high; positions are in its own, {size}"
        ]


class TestStreams:
    picture, small, film = (
        flat_frames([9], height=320, width=480),
        flat_frames([10, 20, 30], height=16, width=32),
        flat_frames([20, 60, 100, 140], height=32, width=48),
    )

    @pytest.mark.parametrize("suffix", [".mp4", ".mov", ".mkv"])
    @pytest.mark.parametrize("default", [False, True])
    def test_a_picture_is_not_the_video(self, suffix: str, default: bool, tmp_path: Path):
        streams = [("mjpeg", self.picture, default), ("libx264", self.film, not default)]
        clip = read_clip(write_streams(tmp_path / f"film{suffix}", streams))
        assert clip.frames.shape == self.film.shape

    @pytest.mark.parametrize("suffix", [".mp4", ".mkv"])
    @pytest.mark.parametrize("first", [False, True])
    def test_the_default_stream_is_the_video(self, suffix: str, first: bool, tmp_path: Path):
        streams = [("libx264", self.small, False), ("libx264", self.film, True)]
        path = write_streams(tmp_path / f"film{suffix}", streams[::-1] if first else streams)
        assert read_clip(path).frames.shape == self.film.shape
        assert read_clip(f"{path}@1:3").frames.shape == (2, 32, 48, 3)

    def test_the_default_stream_may_be_the_smaller(self, tmp_path: Path):
        streams = [("libx264", self.film, False), ("libx264", self.small, True)]
        assert read_clip(write_streams(tmp_path / "film.mp4", streams)).frames.shape == self.small.shape

    def test_a_picture_alone_is_none(self, tmp_path: Path):
        with pytest.raises(ClipError, match="has one frame"):
            read_clip(write_streams(tmp_path / "cover.mp4", [("mjpeg", self.picture, True)]))


@pytest.mark.parametrize("name", ["12:30:00.mp4", "http:film.mp4", "shot%03d.mp4", "-clip.mp4", "a b?#&.mp4", "ä.mp4"])
def test_names_that_mean_something_to_ffmpeg(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    write_video(tmp_path / "film.mp4", flat_frames([20, 60], height=32, width=48)).rename(tmp_path / name)
    assert len(read_clip(tmp_path / name)) == 2
    monkeypatch.chdir(tmp_path)
    assert len(read_clip(name)) == 2


class TestTimes:
    frames = flat_frames(range(0, 240, 20), height=32, width=48)

    @pytest.mark.parametrize("suffix", [".mp4", ".mkv"])
    def test_each_frame_has_its_own(self, suffix: str, tmp_path: Path):
        times = [0, 33, 67, 100, 200, 300, 400, 500, 600, 700, 800, 900]
        path = write_video(tmp_path / f"slowing{suffix}", self.frames, 30, times=times)
        clip = read_clip(path)
        np.testing.assert_allclose(clip.times, np.array(times) / 1000, atol=1e-3)
        assert clip.variable_rate
        assert clip.fps == pytest.approx(11 / 0.9)
        np.testing.assert_allclose(read_clip(f"{path}@2:6").times, [0, 0.033, 0.133, 0.233], atol=1e-3)

    @pytest.mark.parametrize("suffix", [".mp4", ".mkv", ".avi", ".h264"])
    @pytest.mark.parametrize("b_frames", [0, 3])
    @pytest.mark.parametrize("rate", [Fraction(12), Fraction(30000, 1001)])
    def test_an_even_rate_is_exact(self, rate: Fraction, b_frames: int, suffix: str, tmp_path: Path):
        """Matroska rounds times to milliseconds; AVI has none of frames that are not shown in the order of decoding."""
        options = {"bf": str(b_frames), "b-adapt": "0"}
        clip = read_clip(write_video(tmp_path / f"even{suffix}", self.frames, rate, options=options))
        assert clip.fps == pytest.approx(float(rate), rel=1e-9)
        assert len(clip) == len(self.frames)

    def test_avi_whose_clock_is_not_its_rate(self, tmp_path: Path, caplog: pytest.LogCaptureFixture):
        options = {"bf": "3", "b-adapt": "0"}
        times = [50 * number for number in range(len(self.frames))]
        path = tmp_path / "clock.avi"
        write_video(path, self.frames, 12, times=times, time_base=Fraction(1, 600), options=options)
        assert read_clip(path).fps == 12.0
        assert caplog.messages == [
            "clock.avi does not say when its frames are shown: they are taken to be even, 12 a second"
        ]

    @pytest.mark.parametrize("options", [{"bf": "0"}, {"bf": "0", "g": "5"}])
    def test_avi_with_places_left_empty(
        self, options: dict[str, str], tmp_path: Path, caplog: pytest.LogCaptureFixture
    ):
        """As recorders leave them where a frame came late: the frame before stays, and nothing is lost."""
        places = [0, 1, 2, 4, 5, 7, 9, 10, 12, 13, 17, 18]
        path = tmp_path / "late.avi"
        write_video(path, self.frames, 12, times=places, time_base=Fraction(1, 12), options=options)
        clip = read_clip(path)
        np.testing.assert_allclose(clip.times, np.array(places) / 12)
        assert clip.variable_rate
        assert [record for record in caplog.records if record.levelno == logging.WARNING] == []
        np.testing.assert_allclose(read_clip(f"{path}@3:7").times, np.array([0, 1, 3, 5]) / 12)

    @pytest.mark.parametrize("suffix", [".mp4", ".mkv"])
    def test_a_frame_an_hour(self, suffix: str, tmp_path: Path):
        clip = read_clip(write_video(tmp_path / f"plants{suffix}", self.frames, Fraction(1, 3600)))
        np.testing.assert_allclose(clip.times, 3600 * np.arange(len(clip)))

    def test_the_header_does_not_decide(self, tmp_path: Path):
        """A browser's recording: the header says 30, the frames came at 15."""
        times = [round(number * 1000 / 15) for number in range(len(self.frames))]
        path = write_video(tmp_path / "recorded.mkv", self.frames, 30, times=times)
        clip = read_clip(path)
        assert clip.fps == pytest.approx(15, rel=1e-2)
        assert not clip.variable_rate

    def test_a_whole_video_is_read_without_a_word(self, tmp_path: Path, caplog: pytest.LogCaptureFixture):
        with caplog.at_level(logging.INFO):
            for suffix in (".mp4", ".mkv", ".avi"):
                read_clip(write_video(tmp_path / f"even{suffix}", self.frames, options={"bf": "0"}))
        assert [message for message in caplog.messages if "even" in message] == []


def noisy_frames(count: int = 36, height: int = 48, width: int = 64) -> npt.NDArray[np.uint8]:
    """Frames that take a coder some hundred bytes each: a drifting texture."""
    texture = np.random.default_rng(0).integers(0, 256, (height, width + count, 3), dtype=np.uint8)
    texture = cv2.GaussianBlur(texture, (0, 0), 2) * 2
    return np.stack([texture[:, number : number + width] for number in range(count)])


def position(path: Path, number: int) -> int:
    """Where a frame begins in the file."""
    with av.open(str(path)) as file:
        found = [packet.pos for packet in file.demux(video=0)][number]
    assert found is not None
    return found


class TestDamaged:
    """What decodes is kept; a warning says what is lost. Every twelfth frame is a key frame."""

    coded = {"g": "12", "bf": "0", "sc_threshold": "0", "crf": "20"}  # noqa: RUF012

    def write(self, path: Path) -> Path:
        header_first = {"movflags": "faststart"} if path.suffix == ".mp4" else None
        return write_video(path, noisy_frames(), options=self.coded, container=header_first)

    @pytest.mark.parametrize("suffix", [".mp4", ".mkv", ".avi"])
    def test_cut_off(self, suffix: str, tmp_path: Path, caplog: pytest.LogCaptureFixture):
        path = tmp_path / f"film{suffix}"
        whole = np.asarray(read_clip(self.write(path)).frames)
        assert caplog.messages == []
        path.write_bytes(path.read_bytes()[: position(path, 20) + 30])
        clip = read_clip(path)
        np.testing.assert_array_equal(clip.frames, whole[:20])
        np.testing.assert_allclose(clip.times, np.arange(20) / 12)
        assert caplog.messages == [
            f"film{suffix} is damaged and has lost 16 frames: 16 after frame 19 (1.58 s); the other 20 are kept and "
            "counted from 0"
        ]

    @pytest.mark.parametrize("suffix", [".mp4", ".mkv"])
    def test_a_hole(self, suffix: str, tmp_path: Path, caplog: pytest.LogCaptureFixture):
        path = self.write(tmp_path / f"film{suffix}")
        whole = np.asarray(read_clip(path).frames)
        content = bytearray(path.read_bytes())
        begin, end = position(path, 14) + 30, position(path, 16) + 30
        content[begin:end] = bytes(end - begin)
        path.write_bytes(content)
        clip = read_clip(path)
        numbers = np.round(clip.times * 12).astype(int)  # in the whole film
        sound = (numbers < 14) | (numbers >= 24)
        assert sound.sum() == 26
        np.testing.assert_array_equal(np.asarray(clip.frames)[sound], whole[numbers[sound]])
        lost = 36 - len(clip)
        assert 0 < lost <= 10
        [warning] = [record.getMessage() for record in caplog.records if record.levelno == logging.WARNING]
        assert warning.startswith(f"film{suffix} is damaged and has lost {lost} frame")
        assert f" after frame 13 (1.08 s); the other {len(clip)} are kept" in warning

    def test_one_frame_left_is_no_clip(self, tmp_path: Path):
        path = self.write(tmp_path / "film.mp4")
        path.write_bytes(path.read_bytes()[: position(path, 1) + 8])
        with pytest.raises(ClipError, match="has one frame"):
            read_clip(path)

    def test_nothing_left(self, tmp_path: Path):
        path = self.write(tmp_path / "film.mp4")
        content = bytearray(path.read_bytes())
        begin = position(path, 0)
        content[begin:] = bytes(len(content) - begin)
        path.write_bytes(content)
        with pytest.raises(ClipError, match=r"film\.mp4 does not decode as a video \(.+\)"):
            read_clip(path)

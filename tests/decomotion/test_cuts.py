"""Cuts are where two clips are joined, and nowhere else."""

from __future__ import annotations

from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from clip_files import write_images, write_video
from decomotion import video
from decomotion.clip import Clip, read_clip
from decomotion.data.cuts import find_cuts
from decomotion.errors import ClipError
from decomotion.frames import Frames
from decomotion.greys import small_grey
from decomotion.long_clip import check_one_shot
from harness.incidents import INCIDENTS
from tiny_fit import sliding_square, texture, write_frames


@pytest.fixture
def two_shots() -> Clip:
    """Eight frames of one picture that slides, then as many of another."""
    height, width = 84, 120
    pictures = [texture(np.random.default_rng(seed), height, width + 8, grain=1.5) for seed in (10, 20)]
    frames = [picture[:, place : place + width] for picture in pictures for place in range(8)]
    return Clip("two", np.stack(frames), 24.0)


def write_film(of: Clip, path: Path) -> Path:
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=24)
        stream.height, stream.width, stream.pix_fmt = of.height, of.width, "yuv420p"
        for frame in of.frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())
    return path


def test_two_joined_clips(two_shots: Clip):
    assert find_cuts(two_shots.frames) == [8]
    assert find_cuts(two_shots.frames[6:10]) == [2]
    with pytest.raises(ClipError, match=r"two cuts to another shot at frame 8, .* --shots split, .* --shots ignore"):
        check_one_shot(two_shots)


def test_one_shot_has_none():
    for frames in (1, 2, 3, 8):
        assert find_cuts(sliding_square(frames).frames) == []
    assert find_cuts(np.zeros((9, 16, 16, 3), np.uint8)) == []
    check_one_shot(sliding_square())


def test_a_fast_pan_is_no_cut():
    """A textured scene passes at an eighth of its width a frame."""
    scene = np.random.default_rng(0).integers(0, 255, (32, 32 + 4 * 12, 3), dtype=np.uint8)
    assert find_cuts(np.stack([scene[:, 4 * frame : 4 * frame + 32] for frame in range(12)])) == []


def pan(seed: int, num_frames: int = 10) -> np.ndarray:
    """A scene of its own, of soft shapes, passes at 3 pixels a frame: [T, 60, 96, 3]."""
    chance = np.random.default_rng(seed)
    scene = sum(
        cv2.resize(chance.normal(0, 30, (*cells, 3)).astype(np.float32), (160, 60), interpolation=cv2.INTER_CUBIC)
        for cells in ((4, 10), (9, 24), (20, 54))
    )
    scene = np.clip(100 + scene, 0, 255).astype(np.uint8)
    return np.stack([scene[:, 3 * frame : 3 * frame + 96] for frame in range(num_frames)])


class TestDrawnScenes:
    def test_a_join_at_any_size(self):
        joined = np.concatenate([pan(0), pan(1)])
        larger = np.stack([cv2.resize(frame, (384, 240), interpolation=cv2.INTER_CUBIC) for frame in joined])
        assert find_cuts(pan(0)) == find_cuts(pan(1)) == []
        assert find_cuts(joined) == find_cuts(larger) == [10]

    @pytest.mark.parametrize("suffix", [".jpg", ".png", ".mp4"])
    @pytest.mark.parametrize("scale", [1, 4, 7])
    def test_a_join_in_files(self, scale: int, suffix: str, tmp_path: Path):
        """JPEGs are decoded smaller than they are, and a video's frames were noted when it was opened."""
        joined = np.concatenate([pan(0), pan(1)])
        larger = np.stack([cv2.resize(frame, (96 * scale, 60 * scale)) for frame in joined]).astype(np.uint8)
        if suffix == ".mp4":
            path = write_video(tmp_path / "joined.mp4", larger)
        else:
            path = write_images(tmp_path / "joined", [f"{number}{suffix}" for number in range(20)], larger)
        frames = read_clip(path).frames
        assert isinstance(frames, Frames)
        assert find_cuts(frames) == [10]
        for number in (0, 13):  # levels of 255: coding, and a video's narrower range
            assert np.abs(frames.grey(number) - small_grey(frames[number])).mean() < 12
        assert find_cuts(frames[8:16]) == [2]

    def test_colour_and_light_do_not_matter(self):
        joined = np.concatenate([pan(0), pan(1)])
        grey = joined.mean(3, keepdims=True).astype(np.uint8).repeat(3, axis=3)
        assert find_cuts(grey) == find_cuts(grey // 4) == [10]

    def test_odd_frames_between(self):
        """A blend of both, one or two like neither: no shots of their own."""
        blend = cv2.addWeighted(pan(0)[-1], 0.5, pan(1)[0], 0.5, 0)
        for odd in ([blend], [pan(2)[0]], [pan(2)[0], pan(3)[0]]):
            (cut,) = find_cuts(np.concatenate([pan(0), odd, pan(1)]))
            assert 10 <= cut <= 10 + len(odd)

    def test_black_belongs_to_the_shot_before(self):
        black = np.zeros((9, 60, 96, 3), np.uint8)
        assert find_cuts(np.concatenate([black, pan(0), black, pan(1), black])) == [28]
        assert find_cuts(np.concatenate([pan(0, 5), black, pan(0)[5:]])) == []

    def test_what_is_soon_over_is_none(self):
        for num_frames in (1, 3, 6):
            whole = pan(0, 20)
            whole[8 : 8 + num_frames] = pan(1)[:num_frames]
            assert find_cuts(whole) == [], num_frames
        whole[8:16] = pan(1)[:8]
        assert find_cuts(whole) == [8, 16]

    def test_where_every_frame_is_another_scene_nothing_is_a_cut(self):
        assert find_cuts(np.stack([pan(seed)[0] for seed in range(9)])) == []

    def test_two_frames(self):
        assert find_cuts(np.stack([pan(0)[0], pan(1)[0]])) == [1]


@pytest.fixture(scope="module")
def clips(shared: Path) -> dict[str, np.ndarray]:
    from decomo_eval.dataset import read_dataset

    files = [shared / "data" / f"tapvid_davis32_{part}.pkl" for part in ("dev", "dev2")]
    return {name: np.asarray(video.frames()) for file in files for name, video in read_dataset(file).items()}


class TestRealClips:
    def test_no_cut_where_there_is_none(self, clips: dict[str, np.ndarray], shared: Path):
        assert {name: cuts for name, frames in clips.items() if (cuts := find_cuts(frames))} == {}
        for name in ("cat", "apple"):
            assert find_cuts(read_clip(shared / "data" / "clips" / f"{name}.mp4").frames) == []

    @pytest.mark.parametrize("pace", [2, 4])
    def test_nor_where_all_goes_faster(self, clips: dict[str, np.ndarray], pace: int):
        assert {name: cuts for name, frames in clips.items() if (cuts := find_cuts(frames[::pace]))} == {}

    def test_any_two_joined(self, clips: dict[str, np.ndarray]):
        names = list(clips)
        for one, other in zip(names, [*names[1:], names[0]], strict=True):
            assert find_cuts(np.concatenate([clips[one][-8:], clips[other][:8]])) == [8], (one, other)

    @pytest.mark.parametrize("incident", INCIDENTS)
    @pytest.mark.parametrize("name", ["libby", "scooter-black"])
    def test_nor_where_something_happens(self, clips: dict[str, np.ndarray], name: str, incident: str):
        frames = clips[name][:24, 30:210]
        assert find_cuts(INCIDENTS[incident](frames, 10, np.random.default_rng(0))) == []


class TestParts:
    def test_frames_of_a_clip(self, two_shots: Clip, tmp_path: Path):
        folder = write_frames(two_shots, tmp_path / "two")
        part = read_clip(f"{folder}@8:16")
        assert part.name == "two-8-16"
        np.testing.assert_array_equal(part.frames, two_shots.frames[8:])

    def test_what_follows_in_a_video_is_not_decoded(
        self, two_shots: Clip, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ):
        film = write_film(two_shots, tmp_path / "two.mp4")
        plain, met = video.decoded, []
        monkeypatch.setattr(video, "decoded", lambda *given: (met.append(frame) or frame for frame in plain(*given)))
        part = read_clip(f"{film}@8:10")
        assert len(met) == 10
        whole = read_clip(film)
        assert (part.name, part.fps, part.frames.shape) == ("two-8-10", whole.fps, (2, 84, 120, 3))
        np.testing.assert_array_equal(part.frames, whole.frames[8:10])

    @pytest.mark.parametrize("wanted", ["0:1", "9:8"])
    def test_of_fewer_than_two_frames(self, two_shots: Clip, tmp_path: Path, wanted: str):
        folder = write_frames(two_shots, tmp_path / "two")
        with pytest.raises(ClipError, match=rf"@{wanted} is not two or more frames"):
            read_clip(f"{folder}@{wanted}")

    @pytest.mark.parametrize("wanted", ["8:17", "20:30"])
    def test_that_it_has_not(self, two_shots: Clip, tmp_path: Path, wanted: str):
        folder, film = write_frames(two_shots, tmp_path / "two"), write_film(two_shots, tmp_path / "two.mp4")
        for path in (folder, film):
            with pytest.raises(ClipError, match=rf"two has frames 0 to 15; @{wanted} is not two or more of them"):
                read_clip(f"{path}@{wanted}")

    def test_a_path_that_looks_like_one(self, two_shots: Clip, tmp_path: Path):
        folder = write_frames(two_shots, tmp_path / "two@0:4")
        assert len(read_clip(folder)) == 16

"""Preparation: right on a clip whose motion is known, done once, and never half-believed."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from decomotion.clip import Clip
from decomotion.config import DataConfig, load
from decomotion.data import prepare as preparation
from decomotion.data.pool import UNKNOWN_MOTION, Pool
from decomotion.data.prepare import prepare
from decomotion.errors import SupervisionError
from tiny_fit import FRAMES, SIZE, TINY_CPU, on_square, sliding_square, true_target, write_frames

MIDDLE = FRAMES // 2


def config(*overrides: str) -> DataConfig:
    return load("cpu", overrides=(*TINY_CPU, *overrides)).data


@pytest.fixture(scope="module")
def clip() -> Clip:
    return sliding_square()


@pytest.fixture(scope="module")
def pool(clip: Clip) -> Pool:
    return prepare(clip, config(), progress=False)


class TestContent:
    def test_shapes(self, pool: Pool):
        points = 256
        assert pool.points.shape == (FRAMES, points, 2)
        assert pool.targets.shape == (FRAMES, FRAMES, points, 2)
        assert pool.confidence.shape == (FRAMES, FRAMES, points)
        assert pool.rgb.shape == (FRAMES, points, 3)
        assert pool.feature.shape == (FRAMES, points, 4)
        assert pool.moving.shape == (FRAMES, points)
        assert pool.camera.shape == pool.object.shape == (FRAMES, 2, 3)

    def test_targets_are_true_where_they_are_confident(self, pool: Pool):
        frame = np.arange(FRAMES)
        truth = true_target(pool.points[:, None], frame[:, None, None], frame[None, :, None])
        error = np.linalg.norm(pool.targets - truth, axis=-1)
        certain = pool.confidence > 127
        assert certain.mean() > 0.4
        # DIS on 32 pixels, an outline included
        assert np.median(error[certain]) < 0.2
        assert (error[certain] < 1).mean() > 0.9

    def test_a_point_in_its_own_frame_is_itself(self, pool: Pool):
        frame = np.arange(FRAMES)
        np.testing.assert_array_equal(pool.targets[frame, frame], pool.points)
        assert (pool.confidence[frame, frame] == 255).all()

    def test_what_leaves_the_image_or_is_covered_is_not_confident(self, pool: Pool):
        frame = np.arange(FRAMES)
        truth = true_target(pool.points[:, None], frame[:, None, None], frame[None, :, None])
        gone = (truth < -1.5).any(-1) | (truth > SIZE + 0.5).any(-1)
        covered = ~on_square(pool.points, frame[:, None])[:, None] & on_square(truth, frame[None, :, None], margin=2)
        assert gone.any()
        assert covered.any()
        assert (pool.confidence[gone] == 0).mean() > 0.95
        assert (pool.confidence[covered] == 0).mean() > 0.8

    def test_the_square_moves_and_the_scene_does_not(self, pool: Pool):
        truth = on_square(pool.points, np.arange(FRAMES)[:, None])
        moving = pool.moving == 1
        assert (truth & moving).sum() / (truth | moving).sum() > 0.6

    def test_camera_and_object_start_near_their_motion(self, pool: Pool):
        """In normalised units a pixel is 2 / 32."""
        gap = np.arange(FRAMES) - MIDDLE
        np.testing.assert_allclose(pool.camera[:, 0, 2], gap * 1 * 2 / SIZE, atol=0.05)
        np.testing.assert_allclose(pool.object[:, 0, 2], gap * -2 * 2 / SIZE, atol=0.05)
        np.testing.assert_allclose(pool.camera[:, :, :2], np.broadcast_to(np.eye(2), (FRAMES, 2, 2)), atol=0.05)

    def test_colours_are_the_clip_s(self, pool: Pool, clip: Clip):
        x, y = np.round(pool.points[3]).astype(int).T
        # read bilinearly between pixels of a fine texture
        assert np.abs(pool.rgb[3].astype(int) - clip.frames[3, y, x]).mean() < 20

    def test_features_have_unit_norm(self, pool: Pool):
        np.testing.assert_allclose(np.linalg.norm(pool.feature.astype(np.float32), axis=-1), 1, atol=5e-3)  # float16


def test_maps_of_another_raster_are_read_where_the_clip_s_pixels_are():
    """A map at half the clip's resolution, whose values are its own x and y: clip pixel 0 lies at -0.25 in it."""
    clip = Clip("half", np.zeros((2, 16, 24, 3), np.uint8), 24.0)
    y, x = np.mgrid[:8, :12].astype(np.float32)
    image = np.stack([x, y, x, y, x, y], axis=-1)
    xy = np.array([[2.5, 4.5], [3.0, 4.0], [20.0, 11.5]], np.float32)
    expected = np.tile((xy + 0.5) / 2 - 0.5, 3)
    np.testing.assert_allclose(preparation._read_map(image, xy, clip), expected, atol=1e-3)


class TestMasks:
    def test_none(self, clip: Clip):
        assert (prepare(clip, config("data.masks=none"), progress=False).moving == UNKNOWN_MOTION).all()

    def test_given(self, clip: Clip, tmp_path: Path):
        masks = np.zeros((FRAMES, SIZE, SIZE, 3), np.uint8)
        masks[:, :, : SIZE // 2] = 255
        write_frames(Clip("masks", masks, 24.0), tmp_path / "masks")
        pool = prepare(clip, config(f"data.masks={tmp_path / 'masks'}"), progress=False)
        np.testing.assert_array_equal(pool.moving, np.round(pool.points[..., 0]) < SIZE // 2)

    def test_that_do_not_fit(self, clip: Clip, tmp_path: Path):
        with pytest.raises(SupervisionError, match="has 0 images but the clip has 8 frames"):
            prepare(clip, config(f"data.masks={tmp_path}"), progress=False)


def test_no_features(clip: Clip):
    assert prepare(clip, config("data.features=none"), progress=False).feature_size == 0


def test_two_frames():
    pool = prepare(sliding_square(2), config("data.flow.intervals=[1,2,4,8]"), progress=False)
    assert pool.num_frames == 2
    assert (pool.confidence[0, 1] > 0).mean() > 0.5


class TestCache:
    @pytest.fixture
    def builds(self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[Path]:
        """An empty cache, and the folders into which pools are built."""
        monkeypatch.setenv("DECOMO_CACHE", str(tmp_path / "cache"))
        build, folders = preparation._build, []

        def counted(*args: object) -> None:
            folders.append(args[3])
            build(*args)  # type: ignore[arg-type]

        monkeypatch.setattr(preparation, "_build", counted)
        return folders

    def test_built_once(self, builds: list[Path], clip: Clip):
        first = prepare(clip, config(), progress=False)
        again = prepare(dataclasses.replace(clip, name="renamed", fps=12.0), config(), progress=False)
        assert len(builds) == 1
        np.testing.assert_array_equal(first.targets, again.targets)

    def test_built_anew_where_asked_for(self, builds: list[Path], clip: Clip, tmp_path: Path):
        prepare(clip, config(), progress=False)
        prepare(clip, config(), rebuild=True, progress=False)
        assert len(builds) == 2
        assert len(list((tmp_path / "cache").iterdir())) == 1

    def test_another_clip_or_setting_is_another_pool(self, builds: list[Path], clip: Clip):
        changed = clip.frames.copy()
        changed[0, 0, 0, 0] ^= 1
        prepare(clip, config("data.features=none"), progress=False)
        prepare(dataclasses.replace(clip, frames=changed), config("data.features=none"), progress=False)
        prepare(clip, config("data.features=none", "data.pool.cycle_threshold=2"), progress=False)
        prepare(clip, config("data.features=none", "data.masks=none"), progress=False)
        assert len(builds) == 4

    def test_other_masks_in_the_same_folder_are_another_pool(self, builds: list[Path], clip: Clip, tmp_path: Path):
        settings = config("data.features=none", f"data.masks={tmp_path / 'masks'}")
        for level in (0, 255):
            for file in (tmp_path / "masks").glob("*"):
                file.unlink()
            if (tmp_path / "masks").exists():
                (tmp_path / "masks").rmdir()
            write_frames(Clip("masks", np.full_like(clip.frames, level), 24.0), tmp_path / "masks")
            assert (prepare(clip, settings, progress=False).moving == (level > 0)).all()
        assert len(builds) == 2

    @pytest.mark.parametrize("failure", [KeyboardInterrupt, MemoryError])
    def test_a_build_that_fails_leaves_nothing(
        self,
        builds: list[Path],
        clip: Clip,
        tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch,
        failure: type[BaseException],
    ):
        def fail(*args: object, **options: object) -> None:
            assert list(builds[0].iterdir()), "written to already"
            raise failure

        settings = config("data.features=none")
        with monkeypatch.context() as patch:
            patch.setattr(preparation.camera, "chain", fail)
            with pytest.raises(failure):
                prepare(clip, settings, progress=False)
        assert list((tmp_path / "cache").iterdir()) == []
        assert prepare(clip, settings, progress=False).num_frames == FRAMES

    def test_what_a_killed_build_left_is_not_believed(self, builds: list[Path], clip: Clip, tmp_path: Path):
        settings = config("data.features=none")
        prepare(clip, settings, progress=False)
        whole = next((tmp_path / "cache").iterdir())
        left = whole.rename(whole.with_name(f"{whole.name}.999.partial"))
        (left / "targets.npy").write_bytes(b"half")
        assert prepare(clip, settings, progress=False).targets.shape[0] == FRAMES
        assert len(builds) == 2

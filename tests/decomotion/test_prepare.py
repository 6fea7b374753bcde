"""Preparation: right on a clip whose motion is known, done once, and never half-believed."""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from decomotion.clip import Clip
from decomotion.config import load
from decomotion.data import prepare as preparation
from decomotion.data.config import DataConfig
from decomotion.data.flow import Flow, Frame
from decomotion.data.flow.dis import DisFlow
from decomotion.data.links import budget, costs, flow_store, keypoint_matching, linker, own_flow
from decomotion.data.links import stage as links_stage
from decomotion.data.links.matching import MatchStore
from decomotion.data.links.sift_matching import SiftMatcher
from decomotion.data.masks import isnet, outlines
from decomotion.data.masks.scene import wider
from decomotion.data.pool import UNKNOWN_MOTION, Pool
from decomotion.data.prepare import affordable, making, prepare, prepare_in_stages
from decomotion.data.sampling import pixels
from decomotion.data.stages import Record, Stage
from decomotion.data.working import build_frames
from decomotion.errors import DownloadError, SupervisionError
from tiny_fit import FRAMES, HEIGHT, TINY, TINY_CPU, WIDTH, on_square, sliding_square, true_target, write_frames
from tiny_isnet import write_network

MIDDLE = FRAMES // 2


def config(*overrides: str) -> DataConfig:
    return load("cpu", overrides=(*TINY_CPU, *overrides)).data


@pytest.fixture(scope="module")
def clip() -> Clip:
    return sliding_square()


@pytest.fixture(scope="module")
def pool(clip: Clip) -> Pool:
    return prepare(clip, config(), progress=False)


@pytest.fixture
def builds(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[str]:
    """An empty cache, and the names of the stages that are built."""
    monkeypatch.setenv("DECOMO_CACHE", str(tmp_path / "cache"))
    run, names = Stage.run, []

    def counted(stage: Stage, build: Callable[[Path], dict[str, Any]], rebuild: bool = False) -> Record:
        def build_and_count(folder: Path) -> dict[str, Any]:
            if stage.name != "frames":  # which all others may ask for
                names.append(stage.name)
            return build(folder)

        return run(stage, build_and_count, rebuild)

    monkeypatch.setattr(Stage, "run", counted)
    return names


class TestContent:
    def test_shapes(self, pool: Pool):
        points = 13 * 20
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
        # DIS on 40 pixels, an outline included
        assert np.median(error[certain]) < 0.2
        assert (error[certain] < 1).mean() > 0.9

    def test_a_point_in_its_own_frame_is_itself(self, pool: Pool):
        frame = np.arange(FRAMES)
        np.testing.assert_allclose(pool.targets[frame, frame], pool.points, atol=1e-3)  # packed
        assert (pool.confidence[frame, frame] == 255).all()

    def test_what_leaves_the_image_or_is_covered_is_not_confident(self, pool: Pool):
        frame = np.arange(FRAMES)
        truth = true_target(pool.points[:, None], frame[:, None, None], frame[None, :, None])
        gone = (truth < -1.5).any(-1) | (truth > np.array([WIDTH, HEIGHT]) + 0.5).any(-1)
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
        np.testing.assert_allclose(pool.camera[:, 0, 2], gap * 1 * 2 / WIDTH, atol=0.05)
        np.testing.assert_allclose(pool.object[:, 0, 2], gap * -2 * 2 / WIDTH, atol=0.05)
        np.testing.assert_allclose(pool.camera[:, :, :2], np.broadcast_to(np.eye(2), (FRAMES, 2, 2)), atol=0.05)

    def test_colours_are_the_clip_s(self, pool: Pool, clip: Clip):
        x, y = np.round(pool.points[3]).astype(int).T
        # read bilinearly between pixels of a fine texture
        assert np.abs(pool.rgb[3].astype(int) - clip.frames[3, y, x]).mean() < 20

    def test_features_have_unit_norm(self, pool: Pool):
        np.testing.assert_allclose(np.linalg.norm(pool.feature.astype(np.float32), axis=-1), 1, atol=5e-3)  # float16


class TestMasks:
    def test_none(self, clip: Clip):
        assert (prepare(clip, config("data.masks=none"), progress=False).moving == UNKNOWN_MOTION).all()

    def test_given(self, clip: Clip, tmp_path: Path):
        masks = np.zeros((FRAMES, HEIGHT, WIDTH, 3), np.uint8)
        masks[:, :, : WIDTH // 2] = 255
        write_frames(Clip("masks", masks, 24.0), tmp_path / "masks")
        pool = prepare(clip, config(f"data.masks={tmp_path / 'masks'}"), progress=False)
        np.testing.assert_array_equal(pool.moving, np.round(pool.points[..., 0]) < WIDTH // 2)

    def test_outlines_of_a_network(self, clip: Clip, tmp_path: Path):
        """It tells a red square, two pixels wider than what moves by its links."""
        frame = np.arange(FRAMES)
        frames = clip.frames // 3
        frames[..., 0] += np.uint8(170) * on_square(pixels(HEIGHT, WIDTH), frame[:, None, None], margin=-2)
        red = write_network(tmp_path / "red.onnx", (20, 0, 0), 0.5, (1, 3, HEIGHT, WIDTH))
        reddish = dataclasses.replace(clip, frames=frames)
        by_links, found = (
            prepare(reddish, config(f"data.masks={masks}", "data.features=none"), progress=False)
            for masks in ("auto", red)
        )
        truth = on_square(np.round(found.points), frame[:, None], margin=-2)
        wrong, still_wrong = ((pool.moving == 1) != truth for pool in (by_links, found))
        assert 0 < still_wrong.sum() < 0.8 * wrong.sum()

    @pytest.mark.parametrize("alone", [True, False])
    def test_outlined_masks_are_drawn_once_and_what_they_hold_has_its_own_links(
        self, builds: list[str], clip: Clip, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, alone: bool
    ):
        width = WIDTH - 3
        length, narrow = width / 256, dataclasses.replace(clip, frames=clip.frames[:, :, :width])
        masks = np.zeros((FRAMES, HEIGHT, width), np.bool_)
        for frame, mask in enumerate(masks):
            mask[8:24, 3 + 2 * frame : 16 + 2 * frame] = True
        asked, link, moves = [], linker.linking.link, []

        def outlined(frames: Any, probability: np.ndarray, *_: object) -> Any:
            asked.append((frames.shape, probability.shape))
            return iter(masks)

        def noted(*arguments: Any) -> Any:
            moves.append(arguments[-1])
            return link(*arguments)

        monkeypatch.setattr(making, "outlined", outlined)
        monkeypatch.setattr(linker.linking, "link", noted)
        monkeypatch.setattr(making, "BESIDE", 2 / length)
        monkeypatch.setattr(linker, "DRAWN_TOLERANCE", 5 / length)
        off = (f"data.flow.alone={json.dumps(alone)}", "data.features=none")
        by_links = prepare(narrow, config("data.masks=auto", *off), progress=False)
        network = write_network(tmp_path / "network.onnx")
        found = prepare(narrow, config(f"data.masks={network}", *off), progress=False)
        assert builds == ["links", "features", "motion", *["links"] * alone, "motion"]
        assert asked == [((FRAMES, HEIGHT, width, 3), (FRAMES, 14, 18))]
        for frame, mask in enumerate(masks):
            x, y = np.floor(found.points[frame] + 0.5).astype(int).T
            np.testing.assert_array_equal(found.moving[frame], mask[y, x])
        assert (found.moving != by_links.moving).any()
        if not alone:
            assert moves == [None, None]
            return
        assert moves[:2] == moves[4:6] == [None, None]
        by_links_move, outlined_move = moves[3], moves[7]
        assert (by_links_move.reach, by_links_move.look) == (None, None)
        for frame, mask in enumerate(masks):
            away = cv2.distanceTransform((~outlined_move.mask(frame)).astype(np.uint8), cv2.DIST_L2, 0)
            np.testing.assert_array_equal(outlined_move.mask(frame), wider(mask, 2))
            np.testing.assert_array_equal(outlined_move.reach(frame), away <= 5)
            sharp = cv2.GaussianBlur(narrow.frames[frame], (0, 0), own_flow.BLUR * length)
            np.testing.assert_array_equal(outlined_move.look(frame), sharp)

    def test_without_weights_masks_are_those_of_links(
        self, builds: list[str], clip: Clip, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
    ):
        def offline(_: None) -> Path:
            raise DownloadError("the weights of IS-Net cannot be downloaded on this machine; give its file")

        monkeypatch.setattr(isnet, "file_of", offline)
        prepare(clip, config("data.masks=isnet", "data.features=none"), progress=False)
        assert "on this machine; give its file; until then masks are those of --masks auto" in caplog.text
        builds.clear()
        prepare(clip, config("data.masks=auto", "data.features=none"), progress=False)
        assert builds == []

    def test_another_network_is_another_pool(self, builds: list[str], clip: Clip, tmp_path: Path):
        """Under the same name; one that is no network is refused before any work."""
        file = tmp_path / "network.onnx"
        for bias in (0.0, 1.0, 1.0):
            write_network(file, bias=bias)
            prepare(clip, config(f"data.masks={file}", "data.features=none"), progress=False)
        assert builds == ["links", "features", "motion", "links", "motion"]
        file.write_text("none")
        with pytest.raises(SupervisionError, match=r"network\.onnx is not an ONNX file of IS-Net"):
            prepare(clip, config(f"data.masks={file}", "data.features=none"), progress=False)
        assert len(builds) == 5

    def test_that_do_not_fit(self, clip: Clip, tmp_path: Path):
        with pytest.raises(SupervisionError, match="has 0 images but the clip has 8 frames"):
            prepare(clip, config(f"data.masks={tmp_path}"), progress=False)


def test_no_features(clip: Clip):
    assert prepare(clip, config("data.features=none"), progress=False).feature_size == 0


def test_two_frames():
    pool = prepare(sliding_square(2), config("data.flow.intervals=[1,2,4,8]"), progress=False)
    assert pool.num_frames == 2
    assert (pool.confidence[0, 1] > 0).mean() > 0.5


class TestTracks:
    @pytest.fixture
    def file(self, tmp_path: Path) -> Path:
        """Two points on the square; the second is hidden in the last frame."""
        start = np.array([[5, 13], [11, 19]], np.float32)
        frame = np.arange(FRAMES)
        occluded = np.zeros((2, FRAMES), bool)
        occluded[1, -1] = True
        confidence = np.full((2, FRAMES), 0.5)
        tracks = true_target(start[:, None], np.zeros(1, int), frame[None])
        np.savez(tmp_path / "tracks.npz", tracks=tracks, occluded=occluded, confidence=confidence)
        return tmp_path / "tracks.npz"

    def test_they_come_after_the_grid_in_every_frame(self, clip: Clip, pool: Pool, file: Path):
        with_tracks = prepare(clip, config(f"data.tracks={file}"), progress=False)
        assert with_tracks.num_points == pool.num_points + 2
        np.testing.assert_allclose(with_tracks.points[:, : pool.num_points], pool.points)
        square = true_target(np.array([[5, 13], [11, 19]], np.float32), 0, np.arange(FRAMES)[:, None])
        np.testing.assert_allclose(with_tracks.points[:, pool.num_points :], square)
        links = with_tracks.targets[:, :, pool.num_points :]
        np.testing.assert_allclose(links, np.broadcast_to(square, (FRAMES, *square.shape)), atol=1e-3)

    def test_their_confidence_is_that_of_both_ends(self, clip: Clip, pool: Pool, file: Path):
        confidence = prepare(clip, config(f"data.tracks={file}"), progress=False).confidence[..., pool.num_points :]
        np.testing.assert_array_equal(confidence[..., 0], 128)
        np.testing.assert_array_equal(confidence[:-1, :-1, 1], 128)
        assert not confidence[-1, :, 1].any()
        assert not confidence[:, -1, 1].any()

    def test_filters_leave_them_as_they_are(self, clip: Clip, file: Path):
        cycle, given = "data.filters.cycle=0.5", f"data.tracks={file}"
        alone, pool = prepare(clip, config(cycle), progress=False), prepare(clip, config(cycle, given), progress=False)
        of_grid = pool.confidence[..., : alone.num_points]
        np.testing.assert_array_equal(of_grid, alone.confidence)
        unfiltered = prepare(clip, config(given), progress=False)
        np.testing.assert_array_equal(pool.confidence[..., -2:], unfiltered.confidence[..., -2:])

    def test_more_of_them_than_the_pool_has_room_for(self, clip: Clip, file: Path):
        settings = config(f"data.tracks={file}").model_copy(
            update={"pool": config("data.pool.disk_limit=1", "data.pool.points_per_frame=100000").pool}
        )
        assert prepare(clip, settings, progress=False).num_points < 3000


class TestLimits:
    def test_a_small_disk_gets_fewer_points(self, clip: Clip, caplog: pytest.LogCaptureFixture):
        pool = prepare(clip, config("data.pool.points_per_frame=100000", "data.pool.disk_limit=1"), progress=False)
        assert pool.structure is not None
        size = sum(getattr(pool, name).nbytes for name in ("points", "confidence", "rgb", "feature", "moving"))
        size += sum(getattr(pool.structure, name).nbytes for name in ("places", "covariance", "agreement"))
        assert size + 2 * int(np.prod(pool.targets.shape)) == pytest.approx(2**20, rel=0.1)
        assert "1 MiB have room for" in caplog.text
        assert "of 100000 points a frame" in caplog.text

    def test_too_small_a_disk(self):
        with pytest.raises(SupervisionError, match="a pool of 1 MiB is too small for 80 frames"):
            prepare(Clip("long", np.zeros((80, 32, 32, 3), np.uint8), 24.0), config("data.pool.disk_limit=1"))


class TestFilters:
    def test_off_leaves_no_stage(self, clip: Clip):
        prepared = prepare_in_stages(clip, config(), progress=False)
        assert [stage.name for stage in prepared.stages] == ["links", "features", "motion"]

    def test_on_leaves_fewer_links_which_are_better(self, clip: Clip, pool: Pool):
        prepared = prepare_in_stages(clip, config("data.filters.cycle=0.5"), progress=False)
        assert [stage.name for stage in prepared.stages] == ["links", "features", "filter", "motion"]
        frame = np.arange(FRAMES)
        truth = true_target(pool.points[:, None], frame[:, None, None], frame[None, :, None])
        error = np.linalg.norm(pool.targets[...] - truth, axis=-1)
        before, after = pool.confidence > 0, prepared.pool.confidence > 0
        assert (after <= before).all()
        assert 0.5 < after.sum() / before.sum() < 1
        assert error[after].mean() < error[before & ~after].mean()


class TestCache:
    def test_frames_are_read_once_for_all_stages_and_for_none_that_are_there(
        self, clip: Clip, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ):
        monkeypatch.setenv("DECOMO_CACHE", str(tmp_path / "cache"))
        read = []

        def counted(clip: Clip, *rest: Any) -> dict[str, Any]:
            read.append(clip.name)
            return build_frames(clip, *rest)

        monkeypatch.setattr(making, "build_frames", counted)
        prepare(clip, config(), progress=False)
        assert len(read) == 1
        prepare(clip, config("data.features=none"), progress=False)
        assert len(read) == 1
        prepare(clip, config(), rebuild=True, progress=False)
        assert len(read) == 2
        (frames,) = preparation.cache_root().glob("*/frames-*")
        shutil.rmtree(frames)
        prepare(clip, config(), progress=False)
        assert len(read) == 2

    @pytest.fixture
    def few(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """There is time for all points but one."""
        monkeypatch.setattr(budget.costs, "affordable_points", lambda wanted, *_: wanted - 1)

    def test_built_once(self, builds: list[str], clip: Clip):
        first = prepare(clip, config(), progress=False)
        again = prepare(dataclasses.replace(clip, name="renamed", times=2 * clip.times), config(), progress=False)
        assert builds == ["links", "features", "motion"]
        np.testing.assert_array_equal(first.targets[...], again.targets[...])

    @pytest.mark.parametrize("harm", [Path.unlink, lambda file: os.truncate(file, 100)])
    def test_a_stage_without_its_files_is_made_anew(
        self, builds: list[str], clip: Clip, harm: Callable[[Path], None], tmp_path: Path
    ):
        first = np.array(prepare(clip, config(), progress=False).targets[...])
        (file,) = (tmp_path / "cache").rglob("targets.npy")
        harm(file)
        again = prepare(clip, config(), progress=False)
        np.testing.assert_array_equal(again.targets[...], first)
        assert builds == ["links", "features", "motion", "links", "motion"]

    def test_what_follows_from_links_is_made_anew_with_them(self, builds: list[str], clip: Clip, tmp_path: Path):
        """With the same settings, links of another run may have other gaps."""
        prepare(clip, config("data.filters.cycle=0.5"), progress=False)
        (links,) = (tmp_path / "cache").rglob("links-*")
        shutil.rmtree(links)
        builds.clear()
        prepare(clip, config("data.filters.cycle=0.5"), progress=False)
        assert builds == ["links", "filter", "motion"]

    def test_built_anew_where_asked_for(self, builds: list[str], clip: Clip):
        prepare(clip, config(), progress=False)
        prepare(clip, config(), rebuild=True, progress=False)
        assert builds == 2 * ["links", "features", "motion"]

    def test_another_clip_is_another_pool(self, builds: list[str], clip: Clip):
        changed = clip.frames.copy()
        changed[0, 0, 0, 0] ^= 1
        prepare(clip, config("data.features=none"), progress=False)
        prepare(dataclasses.replace(clip, frames=changed), config("data.features=none"), progress=False)
        assert builds == 2 * ["links", "features", "motion"]

    @pytest.mark.parametrize(
        ("override", "anew"),
        [
            ("data.pool.cycle_threshold=2", ["links", "motion"]),
            ("data.flow.patch_stride=4", ["links", "motion"]),
            ("data.prepare_budget=1000", []),  # gaps are a list
            ("data.pool.points_per_frame=300", ["links", "features", "motion"]),
            ("data.features=densesift", ["features"]),
            ("data.masks=none", ["links", "motion"]),  # nothing is followed by itself
            ("data.flow.alone=false", ["links", "motion"]),
            ("data.filters.cycle=1", ["filter", "motion"]),
        ],
    )
    def test_a_setting_makes_anew_what_depends_on_it(
        self, builds: list[str], clip: Clip, override: str, anew: list[str]
    ):
        prepare(clip, config("data.features=none"), progress=False)
        builds.clear()
        prepare(clip, config("data.features=none", override), progress=False)
        assert builds == anew

    @pytest.mark.parametrize("alone", [True, False])
    def test_other_masks_in_the_same_folder_are_another_pool(
        self, builds: list[str], clip: Clip, alone: bool, tmp_path: Path
    ):
        """With other links where what they hold is followed by itself."""
        settings = config("data.features=none", f"data.masks={tmp_path / 'masks'}")
        settings = settings.model_copy(update={"flow": settings.flow.model_copy(update={"alone": alone})})
        for level in (0, 255):
            shutil.rmtree(tmp_path / "masks", ignore_errors=True)
            write_frames(Clip("masks", np.full_like(clip.frames, level), 24.0), tmp_path / "masks")
            assert (prepare(clip, settings, progress=False).moving == (level > 0)).all()
        assert builds == ["links", "features", "motion", *(["links"] if alone else []), "motion"]

    def test_the_same_masks_in_another_folder_are_the_same_pool(self, builds: list[str], clip: Clip, tmp_path: Path):
        masks = np.zeros((FRAMES, HEIGHT, WIDTH), np.uint8)
        masks[:, 5:12, 3:20] = 255
        for name in ("first", "second"):
            write_frames(Clip(name, np.repeat(masks[..., None], 3, axis=-1), 24.0), tmp_path / name)
        prepare(clip, config("data.features=none", f"data.masks={tmp_path / 'first'}"), progress=False)
        builds.clear()
        prepare(clip, config("data.features=none", f"data.masks={tmp_path / 'second'}"), progress=False)
        assert builds == []

    def test_weights_are_read_before_any_long_work(self, builds: list[str], clip: Clip, tmp_path: Path):
        (tmp_path / "weights.pth").write_text("none")
        settings = config("data.features=aliked", f"data.feature_weights={tmp_path / 'weights.pth'}")
        with pytest.raises(SupervisionError, match="is not a file of weights"):
            prepare(clip, settings, progress=False)
        assert builds == []

    def test_a_killed_run_s_fields_and_gaps_are_gone_on_with(
        self, builds: list[str], clip: Clip, monkeypatch: pytest.MonkeyPatch
    ):
        settings = config("data.features=none", "data.flow.intervals=geometric", "data.flow.alone=false")
        whole = prepare(clip, settings, progress=False)
        shutil.rmtree(preparation.cache_root())
        called: list[tuple[int, int]] = []

        class Killed(DisFlow):
            def __call__(
                self, first: Frame, second: Frame, pair: tuple[int, int] = (0, 1), start: Flow | None = None
            ) -> Flow:
                called.append(pair)
                if len(called) == 24:
                    raise KeyboardInterrupt
                return super().__call__(first, second, pair, start)

        monkeypatch.setattr("decomotion.data.flow.dis.DisFlow", Killed)
        with pytest.raises(KeyboardInterrupt):
            prepare(clip, settings, progress=False)
        partial = next(preparation.cache_root().glob("*/.links-*.partial"))
        (partial / "flow" / "0_1.npy").write_bytes(b"half")
        assert json.loads((partial / "schedule.json").read_text())["intervals"] == [1, 2, 4]
        done = {file.stem for file in (partial / "flow").glob("*.npy")} - {"0_1", "1_0"}  # a couple is made together
        assert len(done) > 10
        called[:] = [(0, 0)] * 50
        again = prepare(clip, settings, progress=False)
        assert not done & {f"{first}_{second}" for first, second in called[50:]}
        assert (0, 1) in called[50:]
        np.testing.assert_array_equal(again.targets[...], whole.targets[...])
        np.testing.assert_array_equal(again.confidence, whole.confidence)

    def test_links_that_are_all_that_is_wanted_serve_a_longer_budget(self, builds: list[str], clip: Clip):
        settings = config("data.features=none", "data.flow.intervals=geometric")
        prepare(clip, settings, progress=False)
        builds.clear()
        longer = settings.model_copy(update={"prepare_budget": 1000.0})
        prepare(clip, longer, progress=False)
        assert builds == []
        assert affordable(clip, longer, 800.0).prepare_budget == 1000.0
        prepare(clip, longer, rebuild=True, progress=False)
        assert builds == ["links", "features", "motion"]

    def test_a_longer_budget_may_give_more(self, builds: list[str], clip: Clip, few: None):
        settings = config("data.features=none", "data.flow.intervals=geometric")
        prepare(clip, settings, progress=False)
        builds.clear()
        prepare(clip, settings.model_copy(update={"prepare_budget": 1000.0}), progress=False)
        assert builds == ["links", "motion"]

    def test_a_short_fit_has_less_of_a_budget_unless_links_are_there(self, builds: list[str], clip: Clip):
        settings = config("data.features=none", "data.flow.intervals=geometric", "data.prepare_budget=180")
        assert affordable(clip, settings, 600.0) is settings
        assert affordable(clip, settings, 100.0).prepare_budget == 75.0
        prepare(clip, settings, progress=False)
        assert affordable(clip, settings, 100.0) is settings
        assert affordable(clip, settings, 100.0, rebuild=True).prepare_budget == 75.0

    def test_outlines_take_of_a_fit_s_time_not_of_the_links_budget(
        self, builds: list[str], clip: Clip, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ):
        """8 frames, of 4 of which the network is asked, which takes 10 seconds each."""
        monkeypatch.setattr(outlines, "MOST", 4)
        monkeypatch.setattr(making, "least_seconds", lambda _: 10.0)
        network = write_network(tmp_path / "network.onnx")
        quick = ("data.features=none", "data.flow.intervals=geometric", "data.prepare_budget=180")
        settings = config(*quick, f"data.masks={network}")
        assert affordable(clip, settings, 600.0) is settings
        assert affordable(clip, settings, 200.0).prepare_budget == 0.75 * 200 - 40
        with pytest.raises(SupervisionError, match=r"about 40 seconds, too many for a fit of 50; give .* 294s"):
            affordable(clip, settings, 50.0)
        prepare(clip, settings, progress=False)
        assert affordable(clip, settings, 50.0) is settings

    @pytest.mark.parametrize("alone", [True, False])
    def test_outlines_that_are_there_take_no_time(
        self, builds: list[str], clip: Clip, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, alone: bool
    ):
        """They are kept with links whose own flow follows them, and else with what moves."""
        monkeypatch.setattr(making, "least_seconds", lambda _: 5.0)
        network = write_network(tmp_path / "network.onnx")
        settings = config("data.features=none", f"data.masks={network}", f"data.flow.alone={json.dumps(alone)}")
        motion = prepare_in_stages(clip, settings, progress=False).stages[-1]
        assert affordable(clip, settings, 50.0) is settings
        shutil.rmtree(motion.folder)
        if alone:
            monkeypatch.setattr(making, "Isnet", lambda *_: pytest.fail("asked again"))
            assert affordable(clip, settings, 50.0) is settings
            prepare(clip, settings, progress=False)
            assert builds == ["links", "features", "motion", "motion"]
        else:
            with pytest.raises(SupervisionError, match="about 40 seconds"):
                affordable(clip, settings, 50.0)

    def test_finished_links_of_a_longer_budget_serve_a_shorter_one(self, builds: list[str], clip: Clip, few: None):
        settings = config("data.features=none", "data.flow.intervals=geometric", "data.prepare_budget=180")

        def prepared(budget: float, **changes: Any) -> DataConfig:
            shorter = affordable(clip, settings, budget / 0.75, **changes)
            prepare(clip, shorter, progress=False, **changes)
            return shorter

        assert prepared(67.5).prepare_budget == 67.5
        prepared(90.0)  # more time may give better ones
        assert builds == ["links", "features", "motion", "links", "motion"]
        builds.clear()
        assert prepared(45.0).prepare_budget == 67.5  # the run's own settings lead to the same links
        prepare(clip, settings.model_copy(update={"prepare_budget": 50.0}), progress=False)
        assert builds == []
        prepared(45.0, seed=1)
        assert builds == ["links", "features", "motion"]  # another seed's points are others

    def test_as_many_points_as_there_is_time_for(
        self, builds: list[str], clip: Clip, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
    ):
        """And an interrupted preparation goes on with them, however fast the machine is by then."""
        settings = config("data.features=none", "data.flow.intervals=geometric", "data.pool.points_per_frame=500")
        monkeypatch.setattr(budget.costs, "affordable_points", lambda *_: 260)

        def killed(*_: Any) -> Any:
            raise KeyboardInterrupt

        with monkeypatch.context() as patch:
            patch.setattr(linker.linking, "link", killed)
            with pytest.raises(KeyboardInterrupt):
                prepare(clip, settings, progress=False)
        assert "260 of 500 points a frame: budget; for all, give" in caplog.text
        for measured in ("hop_costs", "affordable_points"):
            monkeypatch.setattr(budget.costs, measured, killed)
        prepared = preparation.prepare_in_stages(clip, settings, progress=False)
        assert prepared.grid == (13, 20)
        assert prepared.pool.num_points == 260
        assert prepared.pool.thinned == "260 of 500 points a frame: budget"

    def test_a_list_of_gaps_is_linked_whole(self, builds: list[str], clip: Clip, monkeypatch: pytest.MonkeyPatch):
        monkeypatch.setattr(budget.costs, "hop_costs", lambda *_: pytest.fail("measured"))
        pool = prepare(clip, config("data.features=none"), progress=False)
        assert (pool.num_points, pool.thinned) == (260, None)

    def test_without_weights_for_matches_those_of_sift_are_taken(
        self, builds: list[str], clip: Clip, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
    ):
        def offline(*_: object) -> None:
            raise DownloadError("the weights of the xfeat matcher cannot be downloaded on this machine; give both")

        monkeypatch.setattr(keypoint_matching, "KeypointMatcher", offline)
        matched = ["data.features=none", "data.matching.intervals=[4]"]
        prepare(clip, config(*matched, "data.matching.kind=xfeat"), progress=False)
        assert "cannot be downloaded on this machine; give both; until then dense SIFT's are taken" in caplog.text
        assert "links" in builds
        builds.clear()
        caplog.clear()
        prepare(clip, config(*matched), progress=False)  # the same links, and known as what they are
        prepare(clip, config("data.features=none", "data.matching.intervals=[]", "data.matching.kind=xfeat"))
        assert caplog.text == ""
        assert builds.count("links") == 1

    def test_matches_that_are_there_need_no_weights(
        self, builds: list[str], clip: Clip, monkeypatch: pytest.MonkeyPatch
    ):
        settings = config("data.features=none", "data.matching.intervals=[4]", "data.matching.kind=aliked")
        asked: list[str] = []

        def by_sift(kind: str, *_: object) -> SiftMatcher:
            asked.append(kind)
            return SiftMatcher(10)

        monkeypatch.setattr(keypoint_matching, "KeypointMatcher", by_sift)
        prepare(clip, settings, progress=False)
        assert asked == ["aliked"]
        prepare(clip, settings, progress=False)
        assert asked == ["aliked"]
        prepare(clip, settings, progress=False, rebuild=True)
        assert asked == ["aliked"] * 2

    def test_weights_of_matches_count_by_their_content(
        self, builds: list[str], clip: Clip, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ):
        monkeypatch.setattr(keypoint_matching, "KeypointMatcher", lambda *_: SiftMatcher(10))
        files = [tmp_path / name for name in ("one.pt", "other.pt")]
        for file in files:
            file.write_bytes(b"the same")
        for number, expected in ((0, 1), (1, 1), (1, 2)):
            weights = f"data.matching.weights=['{files[number]}']"
            settings = ("data.features=none", "data.matching.intervals=[4]", "data.matching.kind=xfeat", weights)
            prepare(clip, config(*settings), progress=False)
            assert builds.count("links") == expected
            if number and expected == 1:
                files[1].write_bytes(b"another")

    @pytest.mark.parametrize(("masks", "seconds"), [("auto", 176), ("none", 56), ("isnet", 216)])
    def test_too_many_frames_for_the_time_are_refused_at_once(
        self,
        builds: list[str],
        clip: Clip,
        monkeypatch: pytest.MonkeyPatch,
        masks: str,
        seconds: int,
        tmp_path: Path,
    ):
        """8 frames: each has features in 5 seconds, masks in 10, silhouettes in 5 and structure in 2.

        Outlines are compared with the scene twice; their network comes on top."""
        monkeypatch.setattr(isnet, "file_of", lambda _: write_network(tmp_path / "network.onnx"))
        monkeypatch.setattr(making, "least_seconds", lambda _: 5.0)
        monkeypatch.setattr(making, "seconds_to_place", lambda *_: 2.0)
        monkeypatch.setattr(making, "seconds_a_frame", lambda *_: 10.0)
        monkeypatch.setattr(budget.costs, "hop_costs", lambda *_: costs.HopCosts(1.0, 1.0))
        monkeypatch.setattr(MatchStore, "compute", lambda *_: pytest.fail("long work"))
        settings = config("data.flow.intervals=geometric", f"data.masks={masks}")
        sentence = f"8 frames are too many for the time that there is: .* structure {seconds}\\)"
        with pytest.raises(SupervisionError, match=sentence):
            prepare(clip, settings, progress=False)

    def test_a_run_killed_in_its_trials_measures_them_anew(
        self, builds: list[str], clip: Clip, monkeypatch: pytest.MonkeyPatch
    ):
        settings = config("data.features=none", "data.flow.intervals=geometric")

        def killed(*_: object) -> None:
            raise KeyboardInterrupt

        with monkeypatch.context() as patch:
            patch.setattr(budget, "choose_intervals", killed)
            with pytest.raises(KeyboardInterrupt):
                prepare(clip, settings, progress=False)
        assert list(preparation.cache_root().glob("*/.links-*.partial/flow/*.npy"))
        called: list[tuple[int, int]] = []
        estimate = DisFlow.__call__

        def counted(self: DisFlow, first: Frame, second: Frame, pair: tuple[int, int], start: Flow | None) -> Flow:
            called.append(pair)
            return estimate(self, first, second, pair, start)

        monkeypatch.setattr(DisFlow, "__call__", counted)
        monkeypatch.setattr(links_stage, "check_time", lambda *_: None)
        prepare(clip, settings, progress=False)
        assert (0, 1) in called

    def test_the_budget_is_what_others_leave(self, builds: list[str], clip: Clip, monkeypatch: pytest.MonkeyPatch):
        """Of 180 seconds the estimate takes 5, matching 100, and masks will take 8, silhouettes 4, structure 2."""
        left, clock = [], [0.0]

        class Slow(MatchStore):
            def compute(self, progress: bool) -> None:
                super().compute(progress)
                clock[0] += 100.0

        def measured(*_: object) -> costs.HopCosts:
            clock[0] += 5.0
            return costs.HopCosts(1e-9, 1e-9)

        def points(wanted: int, of: object, seconds: float) -> int:
            left.append(seconds)
            return wanted

        for module in (links_stage, flow_store, making):
            monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: clock[0]))
        monkeypatch.setattr(links_stage, "MatchStore", Slow)
        monkeypatch.setattr(making, "seconds_a_frame", lambda *_: 1.0)
        monkeypatch.setattr(making, "seconds_to_place", lambda *_: 0.25)
        monkeypatch.setattr(budget.costs, "hop_costs", measured)
        monkeypatch.setattr(budget.costs, "affordable_points", points)
        settings = config("data.features=none", "data.prepare_budget=180", "data.flow.intervals=geometric")
        links = prepare_in_stages(clip, settings, progress=False).stages[0]
        assert left == [61.0]
        assert links.seconds == {"frames": 0.0, "estimate": 5.0, "matches": 100.0, "flow": 0.0, "links": 0.0}

    @pytest.mark.parametrize("at_once", [linker.LINKED_AT_ONCE, 20_000])
    def test_links_go_on_after_the_part_that_was_done(
        self, builds: list[str], clip: Clip, monkeypatch: pytest.MonkeyPatch, at_once: int
    ):
        """In one block of points or in several, which are linked one by one."""
        whole = prepare(clip, config("data.features=none", "data.flow.alone=false"), progress=False)
        expected = whole.targets[...], np.array(whole.confidence)
        shutil.rmtree(preparation.cache_root())
        monkeypatch.setattr(linker, "LINKED_AT_ONCE", at_once)
        link, begun = linker.linking.link, []

        def killed(*arguments: Any) -> Any:
            begun.append(arguments[0].shape[1])
            if len(begun) == 2:
                raise KeyboardInterrupt
            return link(*arguments)

        monkeypatch.setattr(linker.linking, "link", killed)
        with pytest.raises(KeyboardInterrupt):
            prepare(clip, config("data.features=none", "data.flow.alone=false"), progress=False)
        pool = prepare(clip, config("data.features=none", "data.flow.alone=false"), progress=False)
        np.testing.assert_array_equal(pool.targets[...], expected[0])
        np.testing.assert_array_equal(pool.confidence, expected[1])
        assert (len(begun) > 3) == (at_once == 20_000)
        assert sum(begun[2:]) == 2 * pool.num_points - begun[0]

    def test_what_moves_is_linked_once_more_and_nothing_else(self, builds: list[str], clip: Clip):
        """And more of the square is linked rightly than without its own flow."""
        plain, own = (
            prepare(clip, config("data.features=none", f"data.flow.alone={alone}"), progress=False)
            for alone in ("false", "true")
        )
        differ = (plain.confidence[...] != own.confidence[...]).any(axis=1)
        on = on_square(plain.points, np.arange(FRAMES)[:, None], margin=-3)
        assert differ.any()
        assert not (differ & ~on).any()
        frame = np.arange(FRAMES)
        truth = true_target(plain.points[:, None], frame[:, None, None], frame[None, :, None])
        right = [
            ((np.linalg.norm(pool.targets - truth, axis=-1) < 1) & (pool.confidence > 0)).mean(axis=1)
            for pool in (plain, own)
        ]
        square = on_square(plain.points, frame[:, None])
        assert right[1][square].mean() > right[0][square].mean() + 0.02

    @pytest.mark.parametrize(("calls", "masks"), [(3, "silhouettes"), (4, "silhouettes"), (4, "outlined")])
    def test_a_second_round_is_gone_on_with(
        self, builds: list[str], clip: Clip, monkeypatch: pytest.MonkeyPatch, calls: int, masks: str, tmp_path: Path
    ):
        """Killed at its begin or half way, when some is linked anew: what moves is not looked for again."""
        network = write_network(tmp_path / "network.onnx")
        settings = config("data.features=none", *([f"data.masks={network}"] if masks == "outlined" else []))
        whole = prepare(clip, settings, progress=False)
        expected = whole.targets[...], np.array(whole.confidence), whole.moving
        shutil.rmtree(preparation.cache_root())
        link, begun = linker.linking.link, []

        def killed(*arguments: Any) -> Any:
            begun.append(arguments[0].shape[1])
            if len(begun) == calls:
                raise KeyboardInterrupt
            return link(*arguments)

        monkeypatch.setattr(linker.linking, "link", killed)
        with pytest.raises(KeyboardInterrupt):
            prepare(clip, settings, progress=False)
        monkeypatch.setattr(making, masks, lambda *_: pytest.fail("looked for again"))
        pool = prepare(clip, settings, progress=False)
        assert len(begun) == 5
        assert begun[2] == begun[3] < begun[0] == begun[1] == 260
        np.testing.assert_array_equal(pool.targets[...], expected[0])
        np.testing.assert_array_equal(pool.confidence, expected[1])
        np.testing.assert_array_equal(pool.moving, expected[2])

    def test_fields_do_not_stay(self, builds: list[str], clip: Clip):
        prepare(clip, config(), progress=False)
        names = {file.name for file in preparation.cache_root().glob("*/links-*/*")}
        assert names == {"points.npy", "rgb.npy", "targets.npy", "confidence.npy", "probability.npy", "stage.json"}

    def test_equal_gaps_from_another_estimator_of_the_same_fields(self, builds: list[str], clip: Clip, tmp_path: Path):
        """The user's folder of DIS's fields gives DIS's pool."""
        plain = config()
        plain = plain.model_copy(update={"flow": plain.flow.model_copy(update={"guided": False, "alone": False})})
        pool, estimate = prepare(clip, plain, progress=False), DisFlow(plain.flow)  # type: ignore[arg-type]
        given = tmp_path / "given"
        given.mkdir()
        for gap in (1, 2, 4):
            for first in range(FRAMES):
                for second in (first - gap, first + gap):
                    if 0 <= second < FRAMES:
                        field = estimate(clip.frames[first], clip.frames[second])
                        np.save(given / f"{first}_{second}.npy", field)

        def settings(folder: Path) -> DataConfig:
            return load("cpu", overrides=("data.feature_size=4", *TINY[1:]), flow=str(folder)).data

        builds.clear()
        from_folder = prepare(clip, settings(given), progress=False)
        np.testing.assert_array_equal(from_folder.confidence, pool.confidence)
        np.testing.assert_array_equal(from_folder.targets[...], pool.targets[...])
        prepare(clip, settings(given.rename(tmp_path / "moved")), progress=False)
        assert builds == ["links", "motion"]  # its content counts, not its name

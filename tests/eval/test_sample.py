"""The procedural clip: its maps undo one another, its pictures show its tracks, it is written whole or not at all."""

import pickle
import pickletools
from dataclasses import replace
from itertools import combinations

import cv2
import numpy as np
import pytest

from decomo_eval.sample import Sample, SampleError, generate, write
from decomo_eval.sample.cli import main
from decomo_eval.sample.render import photograph, render_frame, render_layers
from decomo_eval.sample.scene import BACKGROUND, Scene, draw_bodies, draw_scene, is_eventful
from decomo_eval.sample.texture import Texture, draw_grain
from decomo_eval.sample.truth import follow_points
from decomotion.clip import read_clip

FRAMES, SIZE = 8, 64
TIMES = np.linspace(0, 1, FRAMES)


@pytest.fixture(scope="module")
def sample() -> Sample:
    return generate(0, FRAMES, SIZE)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return draw_scene(np.random.default_rng(5), SIZE)


def colour_at(frame: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """Bilinear colours [N, 3] at frame positions [N, 2]."""
    pixel = (xy * len(frame) - 0.5).astype(np.float32)[None]
    return cv2.remap(frame, pixel, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[0]


def coded(scene: Scene) -> Scene:
    """The scene with textures that tell where on which layer one looks: red is u, green is v, blue the layer."""
    layers = []
    for index, layer in enumerate(scene.layers):
        ramp = (np.arange(512, dtype=np.float32) + 0.5) / 512
        image = np.stack([*np.meshgrid(ramp, ramp), np.full((512, 512), index, np.float32)], axis=-1)
        layers.append(replace(layer, texture=Texture(image, layer.texture.extent)))
    return Scene(tuple(layers))


def test_material_and_frame_maps_undo_one_another(scene: Scene) -> None:
    axis = np.linspace(-0.5, 1.5, 21)
    xy = np.stack(np.meshgrid(axis, axis), axis=-1)
    for layer in scene.layers:
        for time in TIMES:
            warp = layer.warp(time)
            again = warp.to_frame(warp.to_material(xy))
            assert np.abs(again - xy).max() * 256 < 1e-6  # pixels; both maps are closed forms in float64


def test_pictures_show_every_point_where_the_tracks_say(scene: Scene) -> None:
    scene = coded(scene)
    maps = np.stack([render_layers(scene, time, SIZE) for time in TIMES])
    truth = follow_points(scene, TIMES, maps, np.random.default_rng(0))
    checked = 0
    for frame, time in enumerate(TIMES):
        picture = render_frame(scene, time, SIZE)
        xy = truth.points[:, frame]
        colours = colour_at(picture, xy)
        pure = np.abs(colours[:, 2] - colours[:, 2].round()) < 1e-4  # away from outlines, where layers mix
        inside = ((xy > 0.5 / SIZE) & (xy < 1 - 0.5 / SIZE)).all(axis=1)
        for index, layer in enumerate(scene.layers):
            mine = (truth.layer == index) & pure & inside
            shown = np.isclose(colours[:, 2], index, atol=1e-4)
            np.testing.assert_array_equal(shown[mine], ~truth.occluded[mine, frame])
            seen = mine & shown
            if not seen.any():
                continue
            uv = (colours[seen, :2].astype(float) * 2 - 1) * layer.texture.extent
            error = np.linalg.norm(layer.warp(time).to_frame(uv) - xy[seen], axis=-1) * SIZE
            assert error.max() < 0.1  # pixels; the map is curved within a pixel, and OpenCV interpolates in 1/32 texels
            checked += len(error)
    assert checked > 200


def test_a_visible_point_keeps_its_colour(scene: Scene) -> None:
    maps = np.stack([render_layers(scene, time, SIZE) for time in TIMES])
    truth = follow_points(scene, TIMES, maps, np.random.default_rng(0))
    first, second = (render_frame(scene, TIMES[frame], 256) for frame in (3, 5))
    both = ~truth.occluded[:, 3] & ~truth.occluded[:, 5]
    before, after = colour_at(first, truth.points[both, 3]), colour_at(second, truth.points[both, 5])
    assert both.sum() > 40
    assert np.median(np.abs(after - before)) < 0.02  # of 1; the pixel grid falls differently on fine texture
    assert np.median(np.abs(after[::-1] - before)) > 0.06


def test_occluded_agrees_with_the_masks(sample: Sample) -> None:
    visible_object = visible_ground = 0
    for frame, mask in enumerate(sample.masks):
        visible = ~sample.occluded[:, frame]
        column, row = np.floor(sample.points[visible, frame] * SIZE).astype(int).T
        kernel = np.ones((3, 3), np.uint8)
        surely_object = cv2.erode(mask.astype(np.uint8), kernel)[row, column]
        surely_ground = cv2.erode((~mask).astype(np.uint8), kernel)[row, column]
        background = np.arange(len(sample.points))[visible] < 36  # background points come first
        assert not surely_object[background].any()
        assert not surely_ground[~background].any()
        visible_object += surely_object.sum()
        visible_ground += surely_ground.sum()
    assert visible_object > 100
    assert visible_ground > 100


def test_a_sample_tries_a_tracker(sample: Sample) -> None:
    count = len(sample.points)
    assert 60 <= count <= 120
    assert sample.video.shape == (FRAMES, SIZE, SIZE, 3)
    assert sample.video.dtype == np.uint8
    assert sample.points.shape == (count, FRAMES, 2)
    assert sample.points.dtype == np.float32
    assert sample.occluded.shape == (count, FRAMES)
    assert sample.masks.shape == (FRAMES, SIZE, SIZE)
    assert (~sample.occluded).any(axis=1).all()
    outside = ((sample.points < 0) | (sample.points >= 1)).any(axis=-1)
    assert sample.occluded[outside].all()
    assert outside.any()
    assert (sample.occluded & ~outside).any()
    assert len(np.unique((~sample.occluded).argmax(axis=1))) > 3, "points appear at different frames"
    assert 0.05 < sample.masks.mean() < 0.5
    assert sample.video.std() > 20


@pytest.mark.parametrize("seed", range(4))
def test_objects_meet_and_leave(seed: int) -> None:
    bodies = draw_bodies(np.random.default_rng(seed))
    assert 2 <= len(bodies) <= 4
    assert is_eventful(bodies)
    grid = np.stack(np.meshgrid(*[(np.arange(48) + 0.5) / 48] * 2), axis=-1)
    shown = np.array([[body.covers(grid, time).mean() for body in bodies] for time in TIMES])
    assert (shown.min(axis=0) < 0.5 * shown.max(axis=0)).any()
    pairs = combinations(bodies, 2)
    assert any((a.covers(grid, time) & b.covers(grid, time)).any() for a, b in pairs for time in TIMES)


def test_a_seed_decides_everything(sample: Sample) -> None:
    again, other = generate(0, FRAMES, SIZE), generate(1, FRAMES, SIZE)
    for name in ("video", "points", "occluded", "masks"):
        assert getattr(again, name).tobytes() == getattr(sample, name).tobytes()
    assert np.abs(other.video.astype(float) - sample.video).mean() > 15
    assert (other.masks != sample.masks).any()


def test_a_longer_clip_shows_the_same_motion(sample: Sample) -> None:
    longer = generate(0, 2 * FRAMES - 1, SIZE)
    np.testing.assert_array_equal(longer.masks[::2], sample.masks)


def test_the_smallest_clip_has_tracks() -> None:
    smallest = generate(3, 2, 32)
    assert len(smallest.points) > 20
    assert (~smallest.occluded).any(axis=1).all()


def test_written_files_hold_the_sample(sample: Sample, tmp_path) -> None:
    assert write(sample, tmp_path / "new") == [tmp_path / "new" / name for name in ("clip", "masks", "sample.pkl")]
    clip = read_clip(tmp_path / "new" / "clip")
    np.testing.assert_array_equal(clip.frames, sample.video)
    masks = read_clip(tmp_path / "new" / "masks")
    np.testing.assert_array_equal(np.asarray(masks.frames)[..., 0], sample.masks * np.uint8(255))

    content = (tmp_path / "new" / "sample.pkl").read_bytes()
    names = {argument for code, argument, _ in pickletools.genops(content) if "UNICODE" in code.name}
    modules = {name for name in names if "." in str(name)}
    assert modules <= {"numpy.core.multiarray", "numpy._core.multiarray", "numpy._core.numeric"}
    record = pickle.loads(content)["sample"]
    np.testing.assert_array_equal(record["points"], sample.points)
    np.testing.assert_array_equal(record["occluded"], sample.occluded)
    assert record["video"] == [file.read_bytes() for file in sorted((tmp_path / "new" / "clip").iterdir())]
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == ["clip", "masks", "sample.pkl"]


def test_an_existing_clip_stays_unless_forced(sample: Sample, tmp_path) -> None:
    write(sample, tmp_path)
    write(sample, tmp_path)  # the very same files are no conflict
    stale = tmp_path / "clip" / "00099.png"
    stale.write_bytes(b"mine")
    with pytest.raises(SampleError, match=r"clip exists already.*--force"):
        write(sample, tmp_path)
    assert stale.read_bytes() == b"mine"
    write(sample, tmp_path, force=True)
    assert not stale.exists()
    assert len(read_clip(tmp_path / "clip")) == FRAMES


def test_a_failed_write_leaves_nothing(sample: Sample, tmp_path) -> None:
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(SampleError, match="cannot write"):
        write(sample, tmp_path / "file")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_command_writes_and_reports(tmp_path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = [str(tmp_path / "s"), "--seed", "2", "--frames", "3", "--size", "32"]
    assert main(arguments) == 0
    printed = capsys.readouterr().out
    assert printed.startswith("3 frames of 32x32, ")
    assert str(tmp_path / "s" / "sample.pkl") in printed
    assert main(arguments) == 0
    assert main([*arguments[:2], "3", *arguments[3:]]) == 2
    assert "--force" in capsys.readouterr().err
    assert main([*arguments[:2], "3", *arguments[3:], "--force"]) == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--frames", "1"], "the number of frames is 1 but must be between 2 and 1000"),
        (["--size", "31"], "the frame size is 31 but must be between 32 and 1024"),
        (["--seed", "-1"], "the seed is -1 but must be 0 or more"),
    ],
)
def test_bad_values_give_one_sentence(
    arguments: list[str], message: str, tmp_path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([str(tmp_path / "s"), *arguments]) == 2
    assert capsys.readouterr().err == f"Error: {message}\n"
    assert not (tmp_path / "s").exists()


def test_help_shows_defaults(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0
    printed = capsys.readouterr().out
    assert "default: 24" in printed
    assert "default: 256" in printed


def test_background_is_the_backmost_layer(scene: Scene) -> None:
    assert scene.layers[BACKGROUND].body.outline is None
    assert all(layer.body.outline is not None for layer in scene.layers[1:])


def test_rows_are_those_of_the_whole_frame(scene: Scene) -> None:
    """Also where an object's outline leads out of them; a frame lower than wide is lit as the middle of a square."""
    whole, rows = render_frame(scene, 0.4, SIZE), range(SIZE // 4, 3 * SIZE // 4)
    bands = [range(row, min(row + 10, rows.stop)) for row in range(rows.start, rows.stop, 10)]
    parts = np.concatenate([render_frame(scene, 0.4, SIZE, band) for band in bands])
    np.testing.assert_allclose(parts, whole[rows.start : rows.stop], atol=1e-5)  # float32 positions
    light, lower = (
        photograph(np.full_like(each, 0.5), 0.3, 0.1, np.random.default_rng(0)).mean(axis=(1, 2))
        for each in (whole, whole[rows.start : rows.stop])
    )
    np.testing.assert_allclose(lower, light[rows.start : rows.stop], atol=0.5)  # of 255; noise of two, averaged
    assert lower.max() - lower.min() > 1


def test_grain_goes_on_where_the_texture_ends() -> None:
    grain = draw_grain(np.random.default_rng(0), pixel=0.001, octaves=2)
    places = np.random.default_rng(1).uniform(-2, 2, (200, 1, 2))
    light = grain.at(places)
    np.testing.assert_allclose(grain.at(places + np.array([grain.extent, -2 * grain.extent])), light, atol=0.02)
    assert np.log(light).std() == pytest.approx(0.07 * 2**0.5, rel=0.2)
    line = np.stack([np.arange(768) * 0.001, np.zeros(768)], axis=-1)[None]
    strength = np.abs(np.fft.rfft(np.log(grain.at(line)[0])))
    assert strength[64:256].sum() > 20 * strength[257:].sum()  # three pixels a cycle and more


def test_large_frames_keep_the_textures_of_smaller_ones() -> None:
    small, large = (draw_scene(np.random.default_rng(3), size) for size in (1024, 1100))
    for one, other in zip(small.layers, large.layers, strict=True):
        assert one.texture.grain is None
        assert other.texture.grain is not None
        np.testing.assert_array_equal(one.texture.image, other.texture.image)

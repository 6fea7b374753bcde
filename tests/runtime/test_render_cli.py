from __future__ import annotations

import shutil
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

import tiny_fit
from decomo_runtime import Tracker, Tracks, contract, removal, render
from decomo_runtime import edits as draw
from decomo_runtime.contract import LAYERS, META_OBJECT_SHARE
from decomo_runtime.pictures import flattened
from decomo_runtime.render_cli import main
from decomotion.clip import read_clip
from full_disk import writes_end_at
from tiny_fit import FRAMES
from tiny_model import write_tiny_model
from true_tracker import TrueTracker

NUM_FRAMES, HEIGHT, WIDTH = 6, 40, 48


def run(*arguments: object) -> int:
    return main([str(argument) for argument in arguments])


def read_png(path: Path) -> np.ndarray:
    """RGB or RGBA, as it was stored."""
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert image is not None
    return image[..., [2, 1, 0, *range(3, image.shape[2])]]


def frames_of(path: Path, layout: str = "rgb24") -> list[np.ndarray]:
    with av.open(str(path)) as container:
        return [frame.to_ndarray(format=layout) for frame in container.decode(video=0)]


def test_a_layer_as_a_video(model_path: Path, tracker: Tracker, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "new" / "fused.mp4"
    assert run(model_path, "--out", out) == 0
    with av.open(str(out)) as container:
        stream = container.streams.video[0]
        assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")
        assert (stream.width, stream.height, float(stream.average_rate or 0)) == (WIDTH, HEIGHT, 12.5)
    frames = frames_of(out)
    assert len(frames) == NUM_FRAMES
    for number, frame in enumerate(frames):
        apart = np.abs(frame.astype(int) - render(tracker, number)[0])
        assert apart.mean() < 3  # lossy, and colours at half the resolution
    printed = capsys.readouterr().out.splitlines()
    assert printed == ["fused of slide, 6 frames", f"wrote {out}"]
    assert list(out.parent.iterdir()) == [out]


@pytest.mark.parametrize("name", ["a.mp4", "m:1.webm", "a.mov"])
def test_a_variable_rate_and_pixels_that_are_not_square(
    write_model: Callable[..., Path], tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
):
    times = np.array([0, 0.033, 0.067, 0.1, 0.4, 0.7])
    model = write_model({contract.META_TIMES: str(times.tolist()), contract.META_PIXEL_ASPECT: repr(16 / 11)})
    monkeypatch.chdir(tmp_path)
    assert run(model, "--layer", "mask", "--frames", "2:6", "--out", name) == 0
    with av.open(f"file:{name}") as container:
        stream = container.streams.video[0]
        shown = [frame.time for frame in container.decode(stream)]
        shape = Fraction(stream.width, stream.height) * (stream.sample_aspect_ratio or 1)
        assert float(shape) == pytest.approx(WIDTH / HEIGHT * 16 / 11, rel=0.02)
    np.testing.assert_allclose(shown, times[2:] - times[2], atol=0.001)


@pytest.mark.parametrize("name", ["a.mp4", "a.webm", "a.mov", "pngs"])
def test_a_full_disk_leaves_nothing(model_path: Path, tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "new" / name
    with writes_end_at(1000):
        assert run(model_path, "--layer", "all", "--size", "256", "--out", out) == 2
    said = capsys.readouterr().err
    assert said.split("\r")[-1] == f"Error: {out}: File too large\n"  # the bar is gone
    assert list(out.parent.iterdir()) == []


def test_objects_as_pngs_with_alpha(model_path: Path, tracker: Tracker, tmp_path: Path):
    assert run(model_path, "--layer", "dynamic", "--frames", "2:4", "--out", tmp_path / "objects") == 0
    assert sorted(path.name for path in (tmp_path / "objects").iterdir()) == ["00002.png", "00003.png"]
    image = read_png(tmp_path / "objects" / "00003.png")
    np.testing.assert_array_equal(image, render(tracker, 3, ["dynamic"])[0])
    assert image[0, 0, 3] == round(255 * (1 - 3 / NUM_FRAMES))  # the tiny model's confidence is t / T


@pytest.mark.parametrize(("suffix", "decoder"), [(".webm", "libvpx-vp9"), (".mov", "prores")])
def test_objects_as_a_video_with_alpha(model_path: Path, tmp_path: Path, suffix: str, decoder: str):
    """Decoded by the library's own decoder: FFmpeg's own of VP9 leaves alpha out."""
    out = tmp_path / f"objects{suffix}"
    assert run(model_path, "--layer", "dynamic", "--out", out) == 0
    with av.open(str(out)) as container:
        stream = container.streams.video[0]
        context = av.CodecContext.create(decoder, "r")
        context.extradata = stream.codec_context.extradata
        context.codec_tag = stream.codec_context.codec_tag
        frames = [frame for packet in container.demux(stream) for frame in context.decode(packet)]
    assert len(frames) == NUM_FRAMES
    for number, frame in enumerate(frames):
        alpha = frame.to_ndarray(format="rgba")[..., 3].astype(int)
        assert np.abs(alpha - 255 * (1 - number / NUM_FRAMES)).max() <= 3


def test_objects_on_chequers_where_there_is_no_alpha(model_path: Path, tracker: Tracker, tmp_path: Path):
    out = tmp_path / "objects.mp4"
    assert run(model_path, "--layer", "dynamic", "--out", out) == 0
    expected = flattened(render(tracker, 4, ["dynamic"])[0])
    assert np.abs(frames_of(out)[4].astype(int) - expected).mean() < 4


def test_all_layers_in_folders(model_path: Path, tracker: Tracker, tmp_path: Path):
    out = tmp_path / "all"
    out.mkdir()  # an empty folder is no obstacle
    assert run(model_path, "--layer", "all", "--frames", "0:2", "--size", "24", "--out", out) == 0
    assert sorted(path.name for path in out.iterdir()) == sorted(LAYERS)
    for layer in LAYERS:
        assert sorted(path.name for path in (out / layer).iterdir()) == ["00000.png", "00001.png"]
        np.testing.assert_array_equal(read_png(out / layer / "00001.png"), render(tracker, 1, [layer], long_side=24)[0])
    assert list(tmp_path.glob(".*")) == []


def test_all_layers_side_by_side(model_path: Path, tracker: Tracker, tmp_path: Path):
    out = tmp_path / "all.mp4"
    assert run(model_path, "--layer", "all", "--out", out) == 0
    frame = frames_of(out)[1].astype(int)
    assert frame.shape == (2 * HEIGHT, 3 * WIDTH, 3)
    assert np.abs(frame[HEIGHT:, :WIDTH] - render(tracker, 1, ["mask"])[0]).mean() < 3


def test_an_odd_size_becomes_even(model_path: Path, tmp_path: Path):
    assert run(model_path, "--size", "21", "--out", tmp_path / "a.mp4") == 0
    assert frames_of(tmp_path / "a.mp4")[0].shape == (18, 22, 3)


def test_tracks_on_a_layer_with_trails_in_the_image_or_in_the_scene(write_model: Callable[..., Path], tmp_path: Path):
    """All that the tiny model shows moves as one: with the camera's motion taken out, nothing has a trail."""
    model_path = write_model({META_OBJECT_SHARE: "0.99"})  # of the tiny model all but frame 0 is static then
    Tracker(model_path).track([(0, 10, 10), (0, 30, 20)]).save(tmp_path / "tracks.npz")
    drawn = {}
    for trails in ("image", "camera"):
        arguments = ["--layer", "dynamic", "--overlay", tmp_path / "tracks.npz", "--trails", trails, "--mark", "cross"]
        assert run(model_path, *arguments, "--frames", "3:6", "--out", tmp_path / trails) == 0
        assert [path.name for path in sorted((tmp_path / trails).iterdir())] == ["00003.png", "00004.png", "00005.png"]
        drawn[trails] = read_png(tmp_path / trails / "00003.png").astype(int)
        assert drawn[trails].shape == (11 * HEIGHT, 11 * WIDTH, 3)

    def colourful(picture: np.ndarray, frame: int) -> bool:
        """Where the first point is in `frame`."""
        x, y = (int((place + 0.5) * 11) for place in (10 + frame * 1.5, 10 - frame * 0.5))
        return bool(np.ptp(picture[y, x]) > 100)

    assert colourful(drawn["image"], 3)
    assert colourful(drawn["camera"], 3)
    apart = np.abs(drawn["image"] - drawn["camera"]).max(axis=2)
    behind = apart[107:124, 121:138]  # about where it was in frames 0 and 1
    assert (behind > 60).any()


def test_tracks_on_a_layer_of_the_size_asked_for(model_path: Path, tracker: Tracker, tmp_path: Path):
    tracker.track([(0, 10, 30)]).save(tmp_path / "tracks.npz")
    arguments = ["--layer", "mask", "--overlay", tmp_path / "tracks.npz", "--frames", "0:1", "--out", tmp_path / "out"]
    assert run(model_path, *arguments, "--size", "144") == 0
    picture = read_png(tmp_path / "out" / "00000.png")
    assert picture.shape == (3 * HEIGHT, 3 * WIDTH, 3)
    rows, columns = np.nonzero(np.ptp(picture, axis=2) > 100)
    np.testing.assert_allclose([columns.mean(), rows.mean()], [3 * 10.5 - 0.5, 3 * 30.5 - 0.5], atol=0.5)


def test_the_clip_without_its_objects(
    tiny_clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    model = write_tiny_model(tmp_path / "model.onnx", num_frames=FRAMES, height=tiny_fit.HEIGHT, width=tiny_fit.WIDTH)
    true = TrueTracker()
    monkeypatch.setattr(Tracker, "sample", lambda self, queries: true.sample(queries))
    monkeypatch.setattr(Tracker, "track", lambda self, queries, frames=None: true.track(queries, frames))
    arguments = [model, "--remove-objects", "--clip", tiny_clip]
    assert run(*arguments, "--out", tmp_path / "removed.mp4") == 0
    assert len(frames_of(tmp_path / "removed.mp4")) == FRAMES
    assert run(*arguments, "--frames", "3:5", "--out", tmp_path / "removed") == 0
    expected = removal.remove_objects(true, read_clip(tiny_clip).frames, [3, 4])
    for number, frame in zip((3, 4), expected, strict=True):
        np.testing.assert_array_equal(read_png(tmp_path / "removed" / f"{number:05d}.png"), frame)
    assert "without objects of tiny, 2 frames" in capsys.readouterr().out


@pytest.fixture
def sliding(tmp_path: Path, tiny_clip: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A model file whose tracker answers truly of the sliding square; beside it `edit.png` of frame 3."""
    model = write_tiny_model(tmp_path / "model.onnx", num_frames=FRAMES, height=tiny_fit.HEIGHT, width=tiny_fit.WIDTH)
    true = TrueTracker()
    monkeypatch.setattr(Tracker, "sample", lambda self, queries: true.sample(queries))
    monkeypatch.setattr(
        Tracker, "track", lambda self, queries, frames=None, max_memory=None: true.track(queries, frames)
    )
    picture = np.zeros((tiny_fit.HEIGHT, tiny_fit.WIDTH, 4), np.uint8)
    picture[12:19, 10:17] = (20, 30, 250, 255)
    cv2.imwrite(str(tmp_path / "edit.png"), picture)
    return model


def test_an_edit_in_all_frames(sliding: Path, tiny_clip: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    arguments = [sliding, "--clip", tiny_clip, "--edit", f"{tmp_path}/edit.png@3", "--edit", f"{tmp_path}/edit.png@3"]
    assert run(*arguments, "--on", "dynamic", "--on", "static", "--frames", "2:5", "--out", tmp_path / "edits") == 0
    assert "edits of tiny, 3 frames" in capsys.readouterr().out
    edits = [draw.Edit(read_png(tmp_path / "edit.png"), 3, on) for on in ("dynamic", "static")]
    frames = draw.draw_edits(Tracker(sliding), read_clip(tiny_clip).frames, edits, [2, 3, 4])
    for number, frame in zip((2, 3, 4), frames, strict=True):
        np.testing.assert_array_equal(read_png(tmp_path / "edits" / f"{number:05d}.png"), frame)
    assert run(*arguments, "--alone", "--out", tmp_path / "alone") == 0
    alone = read_png(tmp_path / "alone" / "00003.png")
    np.testing.assert_array_equal(alone[..., 3] > 0, read_png(tmp_path / "edit.png")[..., 3] > 0)
    assert run(*arguments, "--alone", "--out", tmp_path / "alone.mov") == 0
    with av.open(str(tmp_path / "alone.mov")) as container:
        assert container.streams.video[0].codec_context.name == "prores"
    alpha = frames_of(tmp_path / "alone.mov", "rgba")[3][..., 3]
    np.testing.assert_allclose(alpha, alone[..., 3], atol=12)


@pytest.mark.parametrize(("border", "channels"), [("none", 4), ("crop", 3), ("fill", 3)])
def test_a_clip_held_still(
    sliding: Path, tiny_clip: Path, tmp_path: Path, border: str, channels: int, capsys: pytest.CaptureFixture[str]
):
    arguments = [sliding, "--clip", tiny_clip, "--stabilise", "scene@3", "--by", "translation", "--border", border]
    tables = ["--transforms", tmp_path / "a.csv", "--transforms", tmp_path / "a.nk"]
    assert run(*arguments, *tables, "--out", tmp_path / "still") == 0
    printed = capsys.readouterr().out.splitlines()
    assert printed[0] == "stabilised scene of tiny, 8 frames"
    assert printed[2:] == [f"wrote {tmp_path / 'a.csv'}", f"wrote {tmp_path / 'a.nk'}"]
    assert read_png(tmp_path / "still" / "00000.png").shape == (tiny_fit.HEIGHT, tiny_fit.WIDTH, channels)
    assert len((tmp_path / "a.csv").read_text().splitlines()) == FRAMES + 1
    assert "CornerPin2D" in (tmp_path / "a.nk").read_text()


def test_a_still_video_without_alpha_is_black_where_a_frame_shows_nothing(
    sliding: Path, tiny_clip: Path, tmp_path: Path
):
    out = tmp_path / "still.mp4"
    assert run(sliding, "--clip", tiny_clip, "--stabilise", "scene@7", "--by", "translation", "--out", out) == 0
    first = frames_of(out)[0]
    assert first[:, -5:].max() < 40  # frame 0 lies 7 pixels to the left there
    assert first[:, :-9].mean() > 80


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--edit", "edit.png@3"], "--edit and --clip go together"),
        (["--edit", "edit.png@8", "--clip", "tiny"], "edit.png is over frame 8, which must be within 0 .. 7"),
        (["--edit", "no.png@3", "--clip", "tiny"], "--edit no.png cannot be read"),
        (["--edit", "edit.png", "--clip", "tiny"], "--edit edit.png is not PICTURE@T"),
        (["--edit", "tiny/00000.png@0", "--clip", "tiny"], "has no alpha, or is opaque everywhere"),
        (["--edit", "edit.png@0", "--clip", "tiny", "--on", "seen", "--on", "seen"], "1 of --edit and 2 of --on"),
        (["--edit", "edit.png@0", "--clip", "tiny", "--layer", "mask"], "leave out --layer and --size"),
        (["--edit", "edit.png@0", "--clip", "tiny", "--stabilise", "scene"], "--edit and --stabilise each make a clip"),
        (["--relight"], "--on, --relight and --alone say how an --edit is drawn"),
        (["--stabilise", "scene"], "--stabilise and --clip go together"),
        (["--stabilise", "sky", "--clip", "tiny"], "--stabilise sky is not scene, object or X,Y,WIDTH,HEIGHT"),
        (["--stabilise", "scene@9", "--clip", "tiny"], "the frame of reference, 9, must be within 0 .. 7"),
        (["--stabilise", "99,9,3,3", "--clip", "tiny"], "--stabilise 99,9,3,3@0 lies outside of the frame"),
        (["--stabilise", "scene", "--clip", "tiny", "--overlay", "a.npz"], "leave one out"),
        (["--stabilise", "scene", "--clip", "tiny", "--transforms", "a.doc"], "does not end as a file of tracks does"),
        (["--border", "crop"], "say how the clip is held still; give --stabilise"),
    ],
)
def test_bad_edits_and_stabilisation_are_one_sentence_and_write_nothing(
    sliding: Path,
    tiny_clip: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    sentence: str,
):
    folder = sliding.parent
    monkeypatch.chdir(folder)
    shutil.copytree(tiny_clip, folder / "tiny", dirs_exist_ok=True)
    before = sorted(folder.rglob("*"))
    assert run("model.onnx", "--out", "new", *arguments) == 2
    printed = capsys.readouterr()
    assert sentence in printed.err
    assert printed.err.count("Error") == 1
    assert printed.out == ""
    assert sorted(folder.rglob("*")) == before


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--layer", "sky"], "Invalid value for '--layer'"),
        (["--frames", "4:9"], "--frames 4:9 must select frames within 0:6"),
        (["--size", "0"], "must have a whole number of pixels, got 0"),
        (["--remove-objects"], "--remove-objects and --clip go together"),
        (["--clip", "slide"], "--clip goes together with one of --remove-objects, --edit, --stabilise"),
        (["--remove-objects", "--clip", "slide", "--layer", "mask"], "leave out --layer and --size"),
        (["--remove-objects", "--clip", "slide", "--size", "9"], "leave out --layer and --size"),
        (["--remove-objects", "--clip", "no"], "no does not exist"),
        (["--mark", "cross"], "--mark and --trails say how an --overlay is drawn"),
        (["--trails", "camera"], "--mark and --trails say how an --overlay is drawn"),
        (["--overlay", "no.npz"], "no.npz is not an .npz file of plain arrays"),
        (["--overlay", "some.npz"], "some.npz lacks frame 0 of 6"),
        (["--out", "a.avi"], "--out a.avi must end in .mp4 or .webm or .mov"),
        (["--out", "slide"], "--out slide exists already"),
        (["--out", "model.onnx/a"], "is not a folder that you may write to"),
    ],
)
def test_bad_input_is_one_sentence_and_writes_nothing(
    model_path: Path,
    tracker: Tracker,
    clip_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    sentence: str,
):
    folder = clip_path.parent
    monkeypatch.chdir(folder)
    tracker.track([(0, 10, 10)], [2, 3]).save("some.npz")
    before = sorted(folder.rglob("*"))
    assert run("model.onnx", "--out", "new", *arguments) == 2
    printed = capsys.readouterr()
    assert sentence in printed.err
    assert printed.out == ""
    assert sorted(folder.rglob("*")) == before


def test_a_clip_that_is_not_the_models(model_path: Path, tiny_clip: Path, capsys: pytest.CaptureFixture[str]):
    assert run(model_path, "--remove-objects", "--clip", tiny_clip, "--out", model_path.parent / "new") == 2
    assert "the clip sliding has 8 frames of 40x28 but the model was fitted to slide" in capsys.readouterr().err


@pytest.mark.parametrize("out", ["new", "new.mp4"])
def test_a_model_without_a_static_scene(
    write_model: Callable[..., Path], clip_path: Path, out: str, capsys: pytest.CaptureFixture[str]
):
    model_path = write_model({META_OBJECT_SHARE: "0"})
    assert run(model_path, "--remove-objects", "--clip", clip_path, "--out", model_path.parent / out) == 2
    assert "holds nothing in slide to be static" in capsys.readouterr().err
    assert sorted(path.name for path in model_path.parent.iterdir()) == ["model.onnx", "slide"]


def test_the_video_does_not_replace_the_clip(model_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    clip = tmp_path / "clip.mp4"
    clip.write_bytes(b"a precious video")
    for given in (clip, f"{clip}@0:6"):
        assert run(model_path, "--remove-objects", "--clip", given, "--out", clip) == 2
        assert f"--out {clip} would replace" in capsys.readouterr().err
    assert clip.read_bytes() == b"a precious video"


def test_an_interrupted_rendering_leaves_nothing(model_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    sample = Tracker.sample

    def interrupted(self: Tracker, queries: np.ndarray) -> object:
        if queries[0, 0] == 2:
            raise KeyboardInterrupt
        return sample(self, queries)

    monkeypatch.setattr(Tracker, "sample", interrupted)
    for out in ("a.mp4", "a"):
        assert run(model_path, "--out", tmp_path / out) == 130
    assert list(tmp_path.iterdir()) == [model_path]


def test_tracks_of_a_longer_clip_are_refused(
    model_path: Path, tracker: Tracker, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    tracks = tracker.track([(0, 10, 10)])
    longer = Tracks(tracks.xy, tracks.occluded, tracks.occlusion, tracks.queries, tracks.frames + 1)
    longer.save(tmp_path / "tracks.npz")
    overlay = ["--overlay", tmp_path / "tracks.npz", "--frames", "1:3"]
    assert run(model_path, *overlay, "--out", tmp_path / "new") == 2
    assert "tracks.npz has a frame 6 of 6; give tracks of this model" in capsys.readouterr().err

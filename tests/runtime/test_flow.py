"""Dense correspondence in files: each format is read back by those who read it, with exact values."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenEXR
import pytest

from decomo_runtime import Dense, FlowError, QueryError, Tracker, dense, write_flow
from decomo_runtime.flow import folder as flow_folder
from decomo_runtime.flow import registry
from decomo_runtime.flow.cli import main
from decomo_runtime.flow.found import Found
from decomo_runtime.flow.registry import FORMATS, format_named
from decomo_runtime.flow.series import series_of
from decomotion.windows import FILE_NAME, Windows, split
from full_disk import writes_end_at
from tiny_model import VELOCITY, write_tiny_model

NUM_FRAMES, HEIGHT, WIDTH = 6, 40, 48


@pytest.fixture
def found() -> Found:
    """Of 5x7 pixels, in quarters of a pixel, which all formats hold exactly; some are hidden."""
    flow = np.random.default_rng(0).integers(-40, 40, (5, 7, 2)).astype(np.float32) / 4
    occlusion = np.linspace(0, 1, 35, dtype=np.float32).reshape(5, 7)
    return Found(Dense(flow, occlusion > 0.5, occlusion, 9 * occlusion), 3, 9, pixel_aspect=1.5)


def written(found: Found, name: str, folder: Path) -> Path:
    form = format_named(name)
    path = folder / f"00009{form.ending}"
    form.write(found, path)
    return path


def channels(path: Path) -> tuple[dict[str, np.ndarray], dict[str, object]]:
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: each.pixels.copy() for name, each in file.channels().items()}, dict(file.header())


def test_flo_is_what_opencv_reads(found: Found, tmp_path: Path):
    path = written(found, "flo", tmp_path)
    np.testing.assert_array_equal(cv2.readOpticalFlow(str(path)), found.dense.flow)
    mask = cv2.imread(str(tmp_path / "occlusion" / "00009.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(mask, np.where(found.dense.occluded, 255, 0))


def test_kitti_is_what_its_devkit_reads(found: Found, tmp_path: Path):
    """The devkit: u = (red - 32768) / 64, v = (green - 32768) / 64, valid where blue is not 0."""
    png = cv2.imread(str(written(found, "kitti", tmp_path)), cv2.IMREAD_UNCHANGED)
    assert png.dtype == np.uint16
    blue, green, red = png.transpose(2, 0, 1)
    seen = ~found.dense.occluded
    np.testing.assert_array_equal(blue, seen)
    flow = np.dstack([(red - 32768.0) / 64, (green - 32768.0) / 64])
    np.testing.assert_array_equal(flow[seen], found.dense.flow[seen])
    assert not red[~seen].any()
    assert not green[~seen].any()


def test_kitti_marks_what_it_cannot_hold(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    flow = np.array([[[-512, 0], [511.984375, 0], [511.9999, 0], [0, 512], [0, -512.1], [600, 0]]], np.float32)
    hidden = np.array([[False] * 5 + [True]])
    png = cv2.imread(
        str(written(Found(Dense(flow, hidden, hidden.astype(np.float32)), 0, 1), "kitti", tmp_path)),
        cv2.IMREAD_UNCHANGED,
    )
    assert png[0, :, 0].tolist() == [1, 1, 0, 0, 0, 0]
    assert png[0, :2, 2].tolist() == [0, 65535]
    assert "3 pixels of frame 0 move 512 pixels or more to frame 1" in caplog.text


def test_npz_is_what_numpy_reads(found: Found, tmp_path: Path):
    with np.load(written(found, "npz", tmp_path)) as file:
        assert sorted(file) == ["error", "flow", "from", "occluded", "occlusion", "to"]
        np.testing.assert_array_equal(file["flow"], found.dense.flow)
        np.testing.assert_array_equal(file["occluded"], found.dense.occluded)
        np.testing.assert_array_equal(file["occlusion"], found.dense.occlusion)
        np.testing.assert_array_equal(file["error"], 9 * found.dense.occlusion)
        assert (int(file["from"]), int(file["to"])) == (3, 9)


@pytest.mark.parametrize(("origin", "layer"), [(3, "forward"), (9, "forward"), (12, "backward")])
def test_motion_vectors_go_up_where_y_goes_down(found: Found, tmp_path: Path, origin: int, layer: str):
    path = written(Found(found.dense, origin, 9, 1.5), "motion", tmp_path)
    planes, header = channels(path)
    assert sorted(planes) == ["A", f"{layer}.u", f"{layer}.v"]
    assert all(plane.dtype == np.float32 for plane in planes.values())
    np.testing.assert_array_equal(planes[f"{layer}.u"], found.dense.flow[..., 0])
    np.testing.assert_array_equal(planes[f"{layer}.v"], -found.dense.flow[..., 1])
    np.testing.assert_array_equal(planes["A"], ~found.dense.occluded)
    assert header["pixelAspectRatio"] == 1.5


def test_an_stmap_of_no_motion_is_the_identity(tmp_path: Path):
    """Of 4 pixels the leftmost has its centre at 1/8; of 2 rows the upper one at 3/4 of the height."""
    still = Dense(np.zeros((2, 4, 2), np.float32), np.zeros((2, 4), bool), np.zeros((2, 4), np.float32))
    planes, _ = channels(written(Found(still, 0, 0), "stmap", tmp_path))
    assert planes["R"].tolist() == [[0.125, 0.375, 0.625, 0.875]] * 2
    assert planes["G"].tolist() == [[0.75] * 4, [0.25] * 4]
    assert planes["B"].tolist() == [[0] * 4] * 2
    assert planes["A"].tolist() == [[1] * 4] * 2


def test_an_stmap_brings_the_other_frame_s_picture(model_path: Path, tmp_path: Path):
    """As Nuke applies it: each pixel takes what lies at (R, G) of the picture, from its lower left corner."""
    write_flow(Tracker(model_path), tmp_path / "out", 1, 3, format="stmap")
    planes, _ = channels(tmp_path / "out" / "from-00001" / "00003.exr")
    picture = np.random.default_rng(0).random((HEIGHT, WIDTH)).astype(np.float32)
    x = (planes["R"] * WIDTH - 0.5).astype(np.float32)
    y = ((1 - planes["G"]) * HEIGHT - 0.5).astype(np.float32)
    warped = cv2.remap(picture, x, y, cv2.INTER_NEAREST, borderValue=(-1.0,))
    step = (2 * np.array(VELOCITY)).astype(int)
    assert step.tolist() == [3, -1]
    np.testing.assert_array_equal(warped[1:, :-3], picture[:-1, 3:])
    assert (warped[0] == -1).all()
    assert (warped[:, -3:] == -1).all()


@pytest.mark.parametrize(
    ("asked", "files"),
    [
        ((1, 3, False), {"from-00001/00003": (1, 3)}),
        ((1, 3, True), {"from-00001/00003": (1, 3), "to-00001/00003": (3, 1)}),
        ((1, "all", False), {f"from-00001/0000{t}": (1, t) for t in range(4)}),
        (
            (1, "all", True),
            {f"from-00001/0000{t}": (1, t) for t in range(4)} | {f"to-00001/0000{t}": (t, 1) for t in range(4)},
        ),
        (("all", 2, False), {f"to-00002/0000{t}": (t, 2) for t in range(4)}),
        (("all", "next", False), {f"next/0000{t}": (t, t + 1) for t in range(3)}),
        (
            ("all", "next", True),
            {f"next/0000{t}": (t, t + 1) for t in range(3)} | {f"previous/0000{t + 1}": (t + 1, t) for t in range(3)},
        ),
        ((2, "next", True), {"next/00002": (2, 3), "previous/00003": (3, 2)}),
        (("all", "all", False), {f"from-0000{a}/0000{b}": (a, b) for a in range(4) for b in range(4)}),
    ],
)
def test_names_tell_the_pair(tmp_path: Path, asked: tuple, files: dict[str, tuple[int, int]]):
    origin, target, both = asked
    model = write_tiny_model(tmp_path / "model.onnx", num_frames=4, height=6, width=9)
    out = tmp_path / "out"
    assert write_flow(Tracker(model), out, origin, target, both=both, format="npz").pairs == len(files)
    assert {str(path.relative_to(out).with_suffix("")) for path in out.rglob("*.npz")} == set(files)
    for name, pair in files.items():
        with np.load(out / f"{name}.npz") as file:
            assert (int(file["from"]), int(file["to"])) == pair
            expected = np.broadcast_to((pair[1] - pair[0]) * np.array(VELOCITY), (6, 9, 2))
            np.testing.assert_allclose(file["flow"], expected, atol=1e-5)


@pytest.mark.parametrize(
    ("asked", "reason"),
    [
        ((4, 0, False), "--from 4 must be within 0 .. 3"),
        ((0, 4, False), "--to 4 must be within 0 .. 3"),
        ((-1, "all", False), "--from -1 must be within 0 .. 3"),
        ((3, "next", False), "frame 3 is the clip's last"),
        (("all", "all", True), "goes in both directions already"),
        ((np.int64(4), 0, False), "--from 4 must be within 0 .. 3"),
        (("first", 2, False), "--from first is neither a frame's number, counted from 0, nor all"),
        ((2, "last", False), "--to last is neither a frame's number, counted from 0, nor all or next"),
        ((2, 1.5, False), "--to 1.5 is neither"),
        ((True, 2, False), "--from True is neither"),
    ],
)
def test_frames_that_are_none(asked: tuple, reason: str):
    with pytest.raises(FlowError, match=re.escape(reason)):
        series_of(*asked, num_frames=4)


@pytest.mark.parametrize("other", [1, "all", "next"])
def test_numpy_s_numbers_are_frames(other: Any):
    for number in (np.int64(2), np.uint8(2)):
        assert series_of(number, other, False, num_frames=4) == series_of(2, other, False, num_frames=4)
        if other != "next":
            assert series_of(other, number, False, num_frames=4) == series_of(other, 2, False, num_frames=4)


def test_a_clip_of_one_frame_has_no_next_one():
    with pytest.raises(FlowError, match="frame 0 is the clip's last"):
        series_of("all", "next", False, num_frames=1)


def test_frames_that_are_asked_together_are_answered_as_alone(tracker: Tracker, monkeypatch: pytest.MonkeyPatch):
    alone = [tracker.dense(2, to=frame) for frame in (5, 0, 3)]
    asked = []
    track = tracker.track
    monkeypatch.setattr(
        tracker, "track", lambda queries, frames, **options: asked.append(frames) or track(queries, frames, **options)
    )
    monkeypatch.setattr(dense, "ANSWERS", 2 * 17 * HEIGHT * WIDTH)
    for one, each in zip(alone, dense.dense_flows(tracker, 2, (5, 0, 3)), strict=True):
        np.testing.assert_allclose(each.flow, one.flow, atol=1e-5)
        np.testing.assert_allclose(each.occlusion, one.occlusion, atol=1e-5)
        assert one.error is not None
        np.testing.assert_allclose(each.error, one.error, rtol=1e-4)
    assert asked == [[5, 0], [3]]
    with pytest.raises(QueryError, match="it must be within"):
        next(dense.dense_flows(tracker, 2, (6,)))


def test_clips_of_several_windows(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    windows = split(10, [], 6)
    assert len(windows) > 1
    model = tmp_path / "models"
    for window in windows:
        write_tiny_model(model / f"{window.name}.onnx", num_frames=len(window), height=6, width=9)
    Windows("walk", 10, 6, 9, 25.0, windows).save(model / FILE_NAME)
    out = tmp_path / "out"
    assert main([str(model), "--from", "0", "--to", "all", "--out", str(out)]) == 0
    assert len(list((out / "from-00000").glob("*.flo"))) == 10
    flow = cv2.readOpticalFlow(str(out / "from-00000" / "00004.flo"))
    np.testing.assert_allclose(flow, np.broadcast_to(4 * np.array(VELOCITY), (6, 9, 2)), atol=1e-4)
    assert capsys.readouterr().out.startswith("10 pairs of frames of walk, ")


@pytest.mark.parametrize("form", FORMATS, ids=lambda form: form.name)
def test_command(model_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], form):
    out = tmp_path / "new" / "out"
    arguments = ["--from", "1", "--to", "4", "--both", "--format", form.name, "--out", str(out)]
    assert main([str(model_path), *arguments]) == 0
    files = {
        str(path.relative_to(out)) for path in out.rglob("*") if path.is_file() and path.parent.name != "occlusion"
    }
    assert files == {f"from-00001/00004{form.ending}", f"to-00001/00004{form.ending}"}
    summary, *paths = capsys.readouterr().out.splitlines()
    assert re.fullmatch(r"2 pairs of frames of slide, 0% occluded, \d+\.\d\d s", summary)
    assert paths == [f"wrote {out}"]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--from", "0", "--to", "6"], "--to 6 must be within 0 .. 5"),
        (["--from", "-1", "--to", "2"], "'-1' is neither a frame's number, counted from 0, nor all"),
        (["--from", "0", "--to", "last"], "'last' is neither a frame's number, counted from 0, nor all or next"),
        (["--from", "1.5", "--to", "2"], "'1.5' is neither a frame's number"),
        (["--from", "0"], "Missing option '--to'"),
        (["--from", "0", "--to", "1", "--format", "exr"], "'exr' is not one of"),
        (["--from", "all", "--to", "all", "--both"], "leave out --both"),
    ],
)
def test_bad_arguments(
    model_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], sentence: str
):
    assert main([str(model_path), *arguments, "--out", str(tmp_path / "out")]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert sentence in printed.err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["model.onnx"]


def test_a_folder_with_something_in_it_is_left_alone(
    model_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine").touch()
    assert main([str(model_path), "--from", "0", "--to", "1", "--out", str(tmp_path / "out")]) == 2
    assert "exists already" in capsys.readouterr().err
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["mine"]


@pytest.mark.parametrize("name", ["motion", "stmap"])
def test_a_library_that_is_missing_is_named_before_any_work(
    model_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: str
):
    monkeypatch.setattr(registry, "find_spec", lambda library: None)
    monkeypatch.setattr(flow_folder, "dense_flows", lambda *_: pytest.fail("work"))
    out = tmp_path / "out"
    assert main([str(model_path), "--from", "0", "--to", "1", "--format", name, "--out", str(out)]) == 2
    sentence = f"Error: {name} needs OpenEXR, which is not installed; run: pip install 'decomotion[exr]'\n"
    assert capsys.readouterr().err == sentence
    assert not out.exists()


def test_unknown_format(tracker: Tracker, tmp_path: Path):
    with pytest.raises(FlowError, match="pfm is no format of flow; there are flo, kitti, npz, motion, stmap"):
        write_flow(tracker, tmp_path / "out", 0, 1, format="pfm")


@pytest.mark.parametrize("form", FORMATS, ids=lambda form: form.name)
def test_a_full_disk(write_model: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], form):
    model, out = write_model(), tmp_path / "out"
    with writes_end_at(64):
        assert main([str(model), "--from", "0", "--to", "1", "--format", form.name, "--out", str(out)]) == 2
    assert capsys.readouterr().err.strip().endswith("File too large")
    assert [path.name for path in tmp_path.iterdir()] == ["model.onnx"]


def test_the_docs_name_every_format():
    page = (Path(__file__).parents[2] / "docs" / "flow.md").read_text()
    for form in FORMATS:
        assert f"| `{form.name}` |" in page

"""`decomo-measure` from files to files, with a model whose points move by (1.5, -0.5) pixels a frame, 12.5 frames a
second, and are hidden five frames away and farther."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import av
import cv2
import numpy as np
import OpenEXR
import pytest

from decomo_runtime import MeasureSettings, Smoothing, Tracker, measure_points
from decomo_runtime.contract import META_TIMES
from decomo_runtime.measure.cli import main
from decomotion.windows import FILE_NAME, Windows, split
from tiny_model import write_tiny_model

FRAMES, HEIGHT, WIDTH = 8, 40, 48
SMOOTH = ["--smooth", "5,2"]


@pytest.fixture
def model(tmp_path: Path) -> Path:
    return write_tiny_model(tmp_path / "model.onnx", num_frames=FRAMES, height=HEIGHT, width=WIDTH, clip_name="slide")


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    folder = tmp_path / "slide"
    folder.mkdir()
    for number in range(FRAMES):
        picture = np.random.default_rng(number).integers(60, 190, (HEIGHT, WIDTH, 3), np.uint8)
        assert cv2.imwrite(str(folder / f"{number:03d}.png"), picture)
    return folder


def table(path: Path) -> tuple[list[str], list[dict[str, str]]]:
    with open(path, encoding="utf-8", newline="") as file:
        reader = csv.DictReader(file)
        return list(reader.fieldnames or []), list(reader)


def pictures(path: Path) -> list[np.ndarray]:
    with av.open(str(path)) as container:
        return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]


def test_points_as_csv(model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "points.csv"
    points = ["--point", "1,20,15", "--point", "3,30.5,20"]
    assert main([str(model), *points, "--scale", "2mm/px", "--fps", "100", *SMOOTH, "--out", str(out)]) == 0
    names, rows = table(out)
    assert names[:3] == ["point [1]", "frame [1]", "time [s]"]
    assert {"displacement_x [mm]", "speed [mm/s]", "acceleration_y [mm/s^2]", "velocity_gain [1/s]"} <= set(names)
    assert len(rows) == 2 * FRAMES
    row = rows[FRAMES + 5]
    assert (row["point [1]"], row["frame [1]"], row["time [s]"], row["reference [1]"]) == ("1", "5", "0.05", "3")
    assert (float(row["displacement_x [mm]"]), float(row["displacement_y [mm]"])) == pytest.approx((6, -2))
    assert float(row["velocity_x [mm/s]"]) == pytest.approx(300, rel=1e-4)
    assert (row["occluded [1]"], rows[7]["occluded [1]"]) == ("0", "1")
    told, wrote = capsys.readouterr().out.splitlines()
    assert re.fullmatch(r"slide: 2 points in 8 frames, \d+% occluded; lengths in mm", told)
    assert wrote == f"wrote {out}"


def test_points_as_npz_are_what_python_gets(model: Path, tmp_path: Path):
    out = tmp_path / "points.npz"
    assert main([str(model), "--grid", "20@2", *SMOOTH, "--frames", "1:7", "--reference", "7", "--out", str(out)]) == 0
    with np.load(out) as file:
        arrays = {name: file[name] for name in file}
    units, settings = json.loads(str(arrays["units"])), json.loads(str(arrays["settings"]))
    assert units["velocity_x"] == "px/s"
    assert settings["smoothing"]["window"] == 5
    queries = np.array([(2, x, y) for y in (9.5, 29.5) for x in (3.5, 23.5, 43.5)])
    motion = measure_points(
        Tracker(model), queries, frames=np.arange(1, 7), reference=7, settings=MeasureSettings(smoothing=Smoothing(5))
    )
    np.testing.assert_allclose(arrays["displacement_x"], motion.displacement[..., 0], atol=1e-6)
    assert (arrays["occluded"] == motion.hidden).all()
    assert arrays["occluded"].all()  # in the frame of reference


def test_a_region(model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "region.csv"
    box = ["--box", "10,10,20,15@1", "--spacing", "5", *SMOOTH]
    assert main([str(model), *box, "--out", str(out)]) == 0
    names, rows = table(out)
    wanted = ("green_lagrange_xx [1]", "small_strain_xy [1]", "principal_1 [1]", "rotation [deg]", "area_change [1]")
    assert set(wanted) <= set(names)
    assert [row["occluded [1]"] for row in rows] == ["0"] * 6 + ["1"] * 2
    for name in ("green_lagrange_xx [1]", "rotation [deg]", "area_change [1]"):
        np.testing.assert_allclose([float(row[name]) for row in rows], 0, atol=1e-4)
    assert [float(row["displacement_x [px]"]) for row in rows] == pytest.approx(1.5 * np.arange(-1, 7), abs=1e-4)
    assert "slide: a region of 12 points in 8 frames" in capsys.readouterr().out


@pytest.mark.parametrize("form", ["npz", "csv", "exr"])
def test_maps(model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], form: str):
    out = tmp_path / "maps"
    arguments = ["--map", "--spacing", "4", "--gauge", "16", "--reference", "2", "--scale", "3um/px", "--format", form]
    assert main([str(model), *arguments, "--frames", "3:5", "--out", str(out)]) == 0
    assert sorted(path.name for path in out.iterdir()) == [f"00003.{form}", f"00004.{form}"]
    path = out / f"00004.{form}"
    if form == "csv":
        names, rows = table(path)
        assert names[:2] == ["reference_x [px]", "reference_y [px]"]
        assert len(rows) == 120
        moved = np.array([float(row["displacement_x [um]"]) for row in rows])
    elif form == "npz":
        with np.load(path) as file:
            assert json.loads(str(file["units"]))["displacement_x"] == "um"
            assert json.loads(str(file["settings"]))["gauge_px"] == [16, 16]
            moved = file["displacement_x"]
            assert moved.shape == (10, 12)
    else:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            header = dict(file.header())
            assert json.loads(str(header["units"]))["residual"] == "um"
            assert json.loads(str(header["settings"]))["reference"] == 2
            moved = file.channels()["displacement_x"].pixels.copy()
            assert not file.channels()["occluded"].pixels.any()
    np.testing.assert_allclose(moved, 9, atol=1e-4)
    told = capsys.readouterr().out.splitlines()[0]
    assert told == "slide: 2 maps of 12x10 nodes against frame 2, gauge 16x16 px, 0% occluded; lengths in um"


def test_a_map_of_a_region(model: Path, tmp_path: Path):
    out = tmp_path / "maps"
    region = ["--polygon", "10,10,40,10,40,30,10,30@2", "--spacing", "4", "--gauge", "8"]
    assert main([str(model), "--map", *region, "--frames", "3:4", "--out", str(out)]) == 0
    with np.load(out / "00003.npz") as file:
        inside = np.isfinite(file["x"])
        x, y = (np.floor(file[name] + 0.5) for name in ("reference_x", "reference_y"))  # the pixels that nodes lie in
    np.testing.assert_array_equal(inside, (np.abs(x - 25) <= 15) & (np.abs(y - 20) <= 10))
    lines = tmp_path / "lines"
    assert main([str(model), "--map", *region, "--frames", "3:4", "--format", "csv", "--out", str(lines)]) == 0
    assert len(table(lines / "00003.csv")[1]) == inside.sum()


@pytest.mark.parametrize(
    "arguments",
    [
        ["--grid", "12@0", *SMOOTH],
        ["--box", "8,8,20,20@0", "--spacing", "5", *SMOOTH, "--show", "rotation", "--limit", "2"],
        ["--map", "--spacing", "4", "--gauge", "8", "--show", "distance"],
    ],
)
def test_overlays(model: Path, clip: Path, tmp_path: Path, arguments: list[str]):
    """In colours where something is in sight; the clip itself is grey. Points are drawn on 528 pixels, 11 times 48."""
    is_map = "--map" in arguments
    out, video = tmp_path / ("maps" if is_map else "points.npz"), tmp_path / "drawn.mp4"
    drawn = ["--overlay", str(video), "--clip", str(clip), "--frames", "0:6"]
    assert main([str(model), *arguments, *drawn, "--out", str(out)]) == 0
    frames = pictures(video)
    assert len(frames) == 6
    with av.open(str(video)) as container:
        assert container.streams.video[0].average_rate == Tracker(model).fps == 12.5  # the folder of frames has none
    assert {frame.shape for frame in frames} == {(40 * 11 + 56, 528, 3)}
    seen, hidden = ((np.ptp(frame[:440].astype(int), axis=-1) > 40).mean() for frame in (frames[1], frames[5]))
    if is_map:
        assert seen > 0.5
        assert hidden == 0
    else:
        assert 0 < hidden < seen or "--show" in arguments


def test_clips_of_several_windows(tmp_path: Path):
    windows = split(12, [], 6)
    assert len(windows) > 1
    model = tmp_path / "models"
    for window in windows:
        write_tiny_model(model / f"{window.name}.onnx", num_frames=len(window), height=HEIGHT, width=WIDTH)
    Windows("walk", 12, HEIGHT, WIDTH, 25.0, windows).save(model / FILE_NAME)
    out = tmp_path / "points.npz"
    assert main([str(model), "--point", "0,10,30", "--out", str(out)]) == 0
    with np.load(out) as file:
        seen = ~file["occluded"][0]
        assert 2 < seen.sum() < 12
        np.testing.assert_allclose(file["displacement_x"][0, seen], 1.5 * np.arange(12)[seen], atol=1e-3)
    maps = tmp_path / "maps"
    assert main([str(model), "--map", "--frames", "9:11", "--reference", "6", "--out", str(maps)]) == 0
    with np.load(maps / "00010.npz") as file:
        np.testing.assert_allclose(file["displacement_y"], -2, atol=1e-3)


POINT = ["--point", "0,10,10"]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ([], "give the points in exactly one way"),
        ([*POINT, "--grid", "9@0"], "give the points in exactly one way"),
        ([*POINT, "--scale", "0.12"], "--scale 0.12 has no unit; give a length for each pixel"),
        ([*POINT, "--fps", "0"], "--fps 0 must be above 0"),
        (POINT, "--smooth 9,2 needs 9 frames but there are 8"),
        ([*POINT, "--reference", "8"], "--reference 8 is no frame of the clip; give one within 0 .. 7"),
        ([*POINT, "--spacing", "4"], "--spacing goes with --mask, --polygon or --box"),
        ([*POINT, "--map"], "leave out single points"),
        (["--map", "--on", "static"], "leave out --on"),
        ([*POINT, "--format", "exr"], "--format and --gauge go with --map"),
        ([*POINT, "--show", "speed"], "--show and --limit say how an --overlay is drawn"),
        ([*POINT, "--clip", "slide"], "--clip goes with --overlay, --refine or --points-from"),
        ([*POINT, "--refine"], "--clip goes with --overlay, --refine or --points-from"),
        (["--points-from", "k.csv", "--refine"], "--clip goes with --overlay, --refine or --points-from"),
        (["--box", "50,2,9,9@0"], "lies outside of the frame"),
        (["--box", "1,2,9,9@8"], "the frame must be within 0 .. 7"),
        (
            ["--map", "--box", "1,2,9,9@2", "--reference", "3"],
            "is of frame 2 but a map is of the frame of reference, 3",
        ),
        (["--map", "--box", "1,2,2,2@2"], "no node of a raster of 8 pixels lies in the region"),
        (["--map", "--gauge", "4"], "--gauge 4 must be at least twice the spacing"),
    ],
)
def test_bad_arguments(
    model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], sentence: str
):
    out = tmp_path / ("maps" if "--map" in arguments else "points.csv")
    if arguments == POINT:
        arguments = [*POINT, "--smooth", "9,2"]
    assert main([str(model), *arguments, "--out", str(out)]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert sentence in printed.err
    assert printed.err.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["model.onnx"]


def test_openexr_may_be_missing(
    model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("decomo_runtime.measure.files.find_spec", lambda _: None)
    assert main([str(model), "--map", "--format", "exr", "--out", str(tmp_path / "maps")]) == 2
    assert "run: pip install 'decomotion[exr]', or take --format npz" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["x", "occluded", "colour"])
def test_what_cannot_be_shown(model: Path, clip: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str):
    drawn = ["--overlay", str(tmp_path / "v.mp4"), "--clip", str(clip), "--show", name]
    assert main([str(model), *POINT, *SMOOTH, *drawn, "--out", str(tmp_path / "p.csv")]) == 2
    assert f"--show {name} is nothing that is measured here; choose from displacement_x," in capsys.readouterr().err
    assert not (tmp_path / "p.csv").exists()


def test_times_that_are_not_steady(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    times = json.dumps([0, 0.08, 0.16, 0.5, 0.58, 0.66, 0.74, 0.82])
    model = write_tiny_model(
        tmp_path / "model.onnx", num_frames=FRAMES, height=HEIGHT, width=WIDTH, metadata={META_TIMES: times}
    )
    out = tmp_path / "p.npz"
    assert main([str(model), *POINT, *SMOOTH, "--fps", "240", "--out", str(out)]) == 2
    assert "leave out --fps, and the clip's own times count" in capsys.readouterr().err
    assert main([str(model), *POINT, *SMOOTH, "--out", str(out)]) == 0
    with np.load(out) as file:
        np.testing.assert_allclose(file["time"], [json.loads(times)])


def test_the_disk_is_not_left_with_halves(model: Path, clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def failing(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("decomo_runtime.measure.files.MAPS", {"npz": failing})
    out = tmp_path / "maps"
    drawn = ["--overlay", str(tmp_path / "v.mp4"), "--clip", str(clip)]
    assert main([str(model), "--map", "--out", str(out), *drawn]) == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["model.onnx", "slide"]

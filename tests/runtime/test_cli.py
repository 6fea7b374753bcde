from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from decomo_runtime import Tracks, contract
from decomo_runtime.cli import main
from decomo_runtime.pictures import write_video

NUM_FRAMES, HEIGHT, WIDTH = 6, 40, 48


def refusal(capsys: pytest.CaptureFixture[str], folder: Path, *arguments: str | Path) -> str:
    """The one sentence with which `decomo-track` refuses `arguments`, having written nothing in `folder`."""
    before = sorted(folder.rglob("*"))
    assert main([str(argument) for argument in arguments]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("Error: ")
    assert printed.err.count("\n") == 1
    assert sorted(folder.rglob("*")) == before
    return printed.err


def test_points_to_npz(model_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "new" / "tracks.npz"
    code = main([str(model_path), "--point", "0,3,4", "--point", "5,-0.5,39.5", "--out", str(out)])
    assert code == 0
    tracks = Tracks.load(out)
    np.testing.assert_array_equal(tracks.queries, [[0, 3, 4], [5, -0.5, 39.5]])
    np.testing.assert_array_equal(tracks.xy[0, -1], [10.5, 1.5])
    summary, *paths = capsys.readouterr().out.splitlines()
    assert summary.startswith("2 points of slide in 6 frames, 33% occluded, ")
    assert paths == [f"wrote {out}"]


def test_csv_to_csv_in_some_frames(model_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "q.csv").write_text("x,y,t\n3,4,0\n")
    out = tmp_path / "tracks.csv"
    arguments = ["--queries", str(tmp_path / "q.csv"), "--frames", "2:4", "--out", str(out)]
    assert main([str(model_path), *arguments]) == 0
    with open(out, newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["point"], row["frame"], float(row["x"]), float(row["y"]), row["occluded"]) for row in rows] == [
        ("0", "2", 6, 3, "0"),
        ("0", "3", 7.5, 2.5, "0"),
    ]
    assert capsys.readouterr().out.startswith("1 point of slide in 2 frames, 0% occluded, ")


def test_grid_with_overlay(model_path: Path, clip_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out, overlay = tmp_path / "tracks.npz", tmp_path / "tracks.mp4"
    arguments = ["--grid", "16@1", "--frames", "1:5", "--out", out, "--overlay", overlay, "--clip", clip_path]
    assert main([str(argument) for argument in (model_path, *arguments)]) == 0
    assert len(Tracks.load(out).queries) == 9
    with av.open(str(overlay)) as container:
        stream = container.streams.video[0]
        assert len(list(container.decode(stream))) == 4
        assert (stream.width, stream.height) == (WIDTH * 11, HEIGHT * 11)
        assert stream.average_rate == 12.5  # the model's; the folder of frames has none
    assert capsys.readouterr().out.splitlines()[1:] == [f"wrote {out}", f"wrote {overlay}"]


@pytest.mark.parametrize(
    ("region", "queries"),
    [
        (["--box", "8,20,9,5@3", "--spacing", "4"], [[3, x, y] for y in (20, 24) for x in (8, 12, 16)]),
        (["--polygon", "4,6,8,6,8,10,4,10@1"], [[1, 6, 8]]),
        (["--mask", "m.png@2", "--spacing", "2.5"], [[2, x, 7] for x in (10.25, 12.75)]),
    ],
)
def test_points_in_a_region(
    model_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, region: list[str], queries: list[list[float]]
):
    monkeypatch.chdir(tmp_path)
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    mask[7, 10:14] = 1
    cv2.imwrite("m.png", mask)
    assert main([str(model_path), *region, "--out", "tracks.npz"]) == 0
    assert Tracks.load("tracks.npz").queries.tolist() == queries


DEEPLABCUT = """\
scorer,net,net,net,net,net,net
bodyparts,nose,nose,nose,tail,tail,tail
coords,x,y,likelihood,x,y,likelihood
1,10.5,20.25,0.7,30,31,0.8
3,11.5,21.25,0.95,32,33,0.7
"""


@pytest.mark.parametrize(
    ("at", "queries"), [("", [[3, 11.5, 21.25], [1, 30, 31]]), ("@1", [[1, 10.5, 20.25], [1, 30, 31]])]
)
def test_keypoints_keep_their_names(model_path: Path, tmp_path: Path, at: str, queries: list[list[float]]):
    (tmp_path / "dog@home.csv").write_text(DEEPLABCUT)
    arguments = ["--points-from", f"{tmp_path / 'dog@home.csv'}{at}", "--out", str(tmp_path / "t.json")]
    assert main([str(model_path), *arguments]) == 0
    saved = json.loads((tmp_path / "t.json").read_text())
    assert [point["name"] for point in saved["points"]] == ["nose", "tail"]
    assert [[point[key] for key in "txy"] for point in saved["points"]] == queries


def test_keypoints_on_objects_only_keep_theirs(model_path: Path, tmp_path: Path):
    """The tiny model's static confidence is t / 6: at frame 3 it is 0.5, not below."""
    (tmp_path / "dog.csv").write_text(DEEPLABCUT)
    arguments = ["--points-from", str(tmp_path / "dog.csv"), "--on", "dynamic", "--out", str(tmp_path / "t.json")]
    assert main([str(model_path), *arguments]) == 0
    assert [point["name"] for point in json.loads((tmp_path / "t.json").read_text())["points"]] == ["tail"]


def test_keypoints_of_images_that_are_named_as_the_clip_s(model_path: Path, clip_path: Path, tmp_path: Path):
    """Of files a.png to f.png the third is frame 2."""
    for number in range(NUM_FRAMES):
        (clip_path / f"{number}.png").rename(clip_path / f"{'abcdef'[number]}.png")
    coco = {
        "images": [{"id": 7, "file_name": "c.png"}],
        "annotations": [{"id": 1, "image_id": 7, "category_id": 1, "keypoints": [5.5, 6, 2]}],
        "categories": [{"id": 1, "name": "dog", "keypoints": ["nose"]}],
    }
    (tmp_path / "coco.json").write_text(json.dumps(coco))
    arguments = [
        "--points-from",
        str(tmp_path / "coco.json"),
        "--clip",
        str(clip_path),
        "--out",
        str(tmp_path / "t.npz"),
    ]
    assert main([str(model_path), *arguments]) == 0
    assert Tracks.load(tmp_path / "t.npz").queries.tolist() == [[2, 5.5, 6]]


def test_keypoints_on_images_of_another_size(model_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    image = {"id": 1, "file_name": "0.png", "frame_id": 0, "width": WIDTH, "height": HEIGHT}
    content: dict[str, Any] = {"images": [image], "categories": [{"id": 1, "keypoints": ["nose"]}]}
    content["annotations"] = [{"image_id": 1, "category_id": 1, "keypoints": [3, 4, 2]}]
    (tmp_path / "a.json").write_text(json.dumps(content))
    arguments = [str(model_path), "--points-from", str(tmp_path / "a.json"), "--out", str(tmp_path / "t.csv")]
    assert main(arguments) == 0
    image["width"] *= 2
    (tmp_path / "a.json").write_text(json.dumps(content))
    (tmp_path / "t.csv").unlink()
    assert main(arguments) == 2
    assert (
        f"a.json is of images of {2 * WIDTH}x{HEIGHT} but the clip is {WIDTH}x{HEIGHT}; give" in capsys.readouterr().err
    )
    assert not (tmp_path / "t.csv").exists()


@pytest.mark.parametrize("overlay", [[], ["--overlay", "tracks.mp4"]])
def test_refined_on_the_clip(
    model_path: Path,
    clip_path: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    overlay: list[str],
):
    monkeypatch.chdir(tmp_path)
    arguments = ["--grid", "9@2", "--out", "tracks.npz", *overlay, "--refine", "--clip", str(clip_path)]
    assert main([str(model_path), *arguments]) == 0
    tracks = Tracks.load("tracks.npz")
    assert tracks.refined is not None
    assert tracks.refined[:, 2].all()  # the queries themselves
    assert not tracks.refined[:, [0, 1, 3, 4, 5]].any()  # each frame is noise of its own
    summary, *paths = capsys.readouterr().out.splitlines()
    assert re.fullmatch(r"30 points of slide in 6 frames, \d+% occluded, 17% refined, .* s", summary)
    assert len(paths) == 1 + len(overlay) // 2


def test_refined_on_another_clip(model_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    other = tmp_path / "other"
    other.mkdir()
    for name in ("0.png", "1.png"):
        cv2.imwrite(str(other / name), np.zeros((HEIGHT, WIDTH, 3), np.uint8))
    arguments = ["--point", "0,1,2", "--out", tmp_path / "a.npz", "--refine", "--clip", other]
    assert "has 2 frames of 48x40 but the model was fitted to slide" in refusal(
        capsys, tmp_path, model_path, *arguments
    )


def test_the_overlay_of_a_variable_rate_lasts_as_long_as_the_clip(write_model: Callable[..., Path], tmp_path: Path):
    times = np.array([0, 0.033, 0.067, 0.1, 0.4, 0.7])
    noise = np.random.default_rng(0).integers(0, 256, (NUM_FRAMES, HEIGHT, WIDTH, 3), np.uint8)
    clip = tmp_path / "phone.mp4"
    write_video(clip, noise, 30.0, times=times, pixel_aspect=16 / 11)
    model = write_model({contract.META_TIMES: str(times.tolist()), contract.META_PIXEL_ASPECT: repr(16 / 11)})
    out, overlay = tmp_path / "tracks.csv", tmp_path / "tracks.mp4"
    arguments = ["--point", "0,3,4", "--frames", "1:6", "--out", out, "--overlay", overlay, "--clip", clip]
    assert main([str(argument) for argument in (model, *arguments)]) == 0
    np.testing.assert_allclose(Tracks.load(out).times, times[1:])
    with av.open(str(overlay)) as container:
        stream = container.streams.video[0]
        shown = [frame.time for frame in container.decode(stream)]
        assert (stream.duration or 0) * (stream.time_base or 0) == pytest.approx(times[-1] - times[1] + 0.3, abs=0.001)
        assert stream.sample_aspect_ratio == Fraction(16, 11)
    np.testing.assert_allclose(shown, times[1:] - times[1], atol=0.001)


@pytest.mark.parametrize(
    ("share", "on", "frames"),
    [(None, "dynamic", [0, 2]), (None, "static", [3, 5]), ("0.3", "dynamic", [0, 2, 3]), ("0.3", "static", [5])],
)
def test_points_on_objects_or_on_the_scene_only(
    write_model: Callable[..., Path], tmp_path: Path, share: str | None, on: str, frames: list[int]
):
    """The tiny model's static confidence is t / 6."""
    out = tmp_path / "tracks.npz"
    model = write_model({contract.META_OBJECT_SHARE: share})
    points = [part for frame in (0, 2, 3, 5) for part in ("--point", f"{frame},3,4")]
    assert main([str(model), *points, "--on", on, "--out", str(out)]) == 0
    assert Tracks.load(out).queries[:, 0].tolist() == frames


def test_trails_without_the_camera_s_motion(write_model: Callable[..., Path], clip_path: Path, tmp_path: Path):
    model_path = write_model({contract.META_OBJECT_SHARE: "0.99"})  # of the tiny model all but frame 0 is static then
    last = {}
    for trails in ("image", "camera"):
        overlay = tmp_path / f"{trails}.mp4"
        arguments = ["--grid", "16@1", "--out", tmp_path / "a.npz", "--clip", clip_path, "--trails", trails]
        assert main([str(argument) for argument in (model_path, *arguments, "--overlay", overlay)]) == 0
        with av.open(str(overlay)) as container:
            frames = [frame.to_ndarray(format="rgb24").astype(int) for frame in container.decode(video=0)]
        assert len(frames) == NUM_FRAMES
        last[trails] = frames[-1]
    assert (np.abs(last["image"] - last["camera"]).max(axis=2) > 60).sum() > 50  # pixels of trails that are gone


def test_no_points_to_follow(model_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "q.csv").write_text("t,x,y\n")
    out = tmp_path / "tracks.npz"
    assert main([str(model_path), "--queries", str(tmp_path / "q.csv"), "--out", str(out)]) == 0
    assert Tracks.load(out).xy.shape == (0, NUM_FRAMES, 2)
    assert capsys.readouterr().out.startswith("0 points of slide in 6 frames, none occluded, ")


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ([], "exactly one way"),
        (["--point", "0,1,2", "--grid", "8@0"], "exactly one way"),
        (
            ["--box", "0,1,2,3@0", "--mask", "a.png@0"],
            "exactly one way: --point, --queries, --grid, --mask, --poly",
        ),
        (["--grid", "8@0", "--spacing", "4"], "--spacing goes with --mask, --polygon or --box; a --grid has its own"),
        (["--mask", "no.png@0"], "--mask no.png cannot be read"),
        (["--points-from", "no.csv"], "no.csv cannot be read"),
        (["--points-from", "points.txt@2"], "points.txt is no file of keypoints by its ending"),
        (["--box", "48,1,2,3@0"], "--box 48,1,2,3@0 lies outside of the frame"),
        (["--polygon", "0,0,9,0,9,9@6"], "the frame must be within 0 .. 5"),
        (["--box", "4,1,2,3@0", "--spacing", "0"], "--spacing 0 must be at least 1 pixel"),
        (["--point", "0,1"], "--point 0,1 is not T,X,Y"),
        (["--point", "0,1,2", "--point", "0,nan,2"], "query row 1 (counted from 0; t=0, x=nan, y=2)"),
        (["--point", "6,1,2"], "t must be within 0 .. 5"),
        (["--point", "0,48,2"], "x must be within -0.5 .. 47.5"),
        (["--grid", "8"], "--grid 8 is not STEP@T"),
        (["--grid", "8@9"], "t must be within 0 .. 5"),
        (["--queries", "no.csv"], "no.csv cannot be read"),
        (["--point", "0,1,2", "--frames", "5:9"], "--frames 5:9 must select frames within 0:6"),
        (["--point", "0,1,2", "--overlay", "a.mp4"], "--clip goes with --overlay, --refine or --points-from"),
        (["--point", "0,1,2", "--refine"], "--clip goes with --overlay, --refine or --points-from"),
        (["--point", "0,1,2", "--clip", "slide"], "--clip goes with --overlay, --refine or --points-from"),
        (["--point", "0,1,2", "--refine", "--clip", "no"], "no does not exist"),
        (["--point", "0,1,2", "--overlay", "a.avi", "--clip", "slide"], "--overlay a.avi must end in .mp4"),
        (["--point", "0,1,2", "--overlay", "a.mp4", "--clip", "no"], "no does not exist"),
        (["--point", "0,1,2", "--mark", "cross"], "--mark and --trails say how an --overlay is drawn"),
    ],
)
def test_bad_arguments(
    model_path: Path,
    clip_path: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    sentence: str,
):
    monkeypatch.chdir(tmp_path)
    assert sentence in refusal(capsys, tmp_path, model_path, *arguments, "--out", "tracks.npz")


def test_bad_output(model_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    arguments = [model_path, "--point", "0,1,2", "--out"]
    assert "does not end as a file of tracks does" in refusal(capsys, tmp_path, *arguments, tmp_path / "a.xyz")
    assert "is not a folder" in refusal(capsys, tmp_path, *arguments, model_path / "a.npz")


def test_bad_models(write_model: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    arguments = ["--point", "0,1,2", "--out", tmp_path / "a.npz"]
    assert "does not exist" in refusal(capsys, tmp_path, tmp_path / "no.onnx", *arguments)
    newer = write_model({contract.META_FORMAT_VERSION: "99"})
    assert "has format version 99" in refusal(capsys, tmp_path, newer, *arguments)
    newer.write_text("not a model")
    assert "is not an ONNX file" in refusal(capsys, tmp_path, newer, *arguments)


def test_a_clip_that_is_not_the_models(
    model_path: Path, clip_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    arguments = ["--grid", "9@0", "--out", tmp_path / "a.npz", "--overlay", tmp_path / "a.mp4", "--clip", clip_path]
    (clip_path / "0.png").unlink()
    sentence = "the clip slide has 5 frames of 48x40 but the model was fitted to slide with 6 frames of 48x40"
    assert sentence in refusal(capsys, tmp_path, model_path, *arguments)
    for number in range(NUM_FRAMES):
        cv2.imwrite(str(clip_path / f"{number}.png"), np.zeros((20, 20, 3), np.uint8))
    assert "6 frames of 20x20 but" in refusal(capsys, tmp_path, model_path, *arguments)


def test_what_is_read_is_not_replaced(model_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    clip, points = tmp_path / "clip.mp4", tmp_path / "points.csv"
    for path in (clip, points):
        path.write_bytes(b"precious")
    for given in (clip, f"{clip}@0:6"):
        arguments = ["--grid", "9@0", "--out", tmp_path / "a.npz", "--overlay", clip, "--clip", given]
        assert f"--overlay {clip} would replace" in refusal(capsys, tmp_path, model_path, *arguments)
    assert "would replace" in refusal(capsys, tmp_path, model_path, "--queries", points, "--out", points)
    keypoints = ["--points-from", f"{points}@2", "--out", points]
    assert "would replace" in refusal(capsys, tmp_path, model_path, *keypoints)
    assert clip.read_bytes() == points.read_bytes() == b"precious"


def test_usage(capsys: pytest.CaptureFixture[str]):
    assert main(["model.onnx"]) == 2
    assert "Missing option '--out'" in capsys.readouterr().err
    assert main(["--help"]) == 0
    text = capsys.readouterr().out
    for option in ("--point T,X,Y", "--queries CSV", "--grid STEP@T", "--frames A:B", "--overlay", "default: (all)"):
        assert option in text

"""Clips at full length and procedural ones: what is counted, by hand; and the program on a clip in seconds."""

from __future__ import annotations

import json
import pickle
import sys
from pathlib import Path
from shutil import copyfile
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image

import footage
from decomo_eval.dataset import Video
from decomo_eval.predictions import Prediction
from decomo_eval.tapvid import Queries
from decomo_runtime import Tracker, Tracks
from decomotion.clip import read_clip
from decomotion.console import run
from harness import plan
from harness.crossing import copied, crossing_figures
from harness.footage_table import mean_text, share_within, table
from harness.full_length import carry, end_figures, first_frames_figures, mask_figures, position_figures
from harness.scenery import ACT, Scenery, precision_figures
from harness.usage import StageError, measured, toolkit
from tiny_fit import AFFINE, FRAMES, HEIGHT, TINY_CPU, WIDTH, sliding_square, write_frames
from tiny_model import VELOCITY, write_tiny_model

NAME = "sliding"


def video(points: np.ndarray, occluded: np.ndarray) -> Video:
    frames = np.zeros((occluded.shape[1], 20, 40, 3), np.uint8)
    return Video(NAME, frames, 20, 40, np.asarray(points, float) / 256, np.asarray(occluded, bool))


def test_what_is_not_annotated_counts_nowhere():
    """Two tracks of six frames, annotated in three and two: the answers are off by 3 px, and by 5 and 0."""
    points = np.full((2, 6, 2), 100.0)
    occluded = np.array([[0, 1, 0, 1, 0, 1], [1, 0, 1, 1, 1, 0]], bool)

    def ask(_: Video, queries: Queries) -> Prediction:
        tracks = queries.tracks + 300  # far off where nobody looks
        tracks[0, [2, 4]] = 100 + np.array([3, 0])
        tracks[1, 5] = 100 + np.array([0, 5])
        return Prediction(tracks, np.zeros(tracks.shape[:2], bool), (40, 20))

    found = position_figures(video(points, occluded), ask)
    told = found["metrics"]["first"]
    assert [told[f"pts_within_{pixels}"] for pixels in (1, 2, 4, 8, 16)] == pytest.approx([0, 0, 2 / 3, 1, 1])
    assert set(told) == {*(f"pts_within_{pixels}" for pixels in (1, 2, 4, 8, 16)), "average_pts_within_thresh"}
    assert found["tracks"] == pytest.approx([0.6, 0.4])
    assert end_figures(video(points, occluded), ask)["errors"] == pytest.approx([3, 3, 5])
    assert share_within([3, 5, 4], 4) == [1, 0, 0]


def test_legs_are_twelve_of_badja_s_joints():
    """Answers are off by 20 px at the neck, the tail and the head; at a paw in one frame of two."""
    points, occluded = np.full((20, 3, 2), 100.0), np.zeros((20, 3), bool)

    def ask(_: Video, queries: Queries) -> Prediction:
        tracks = queries.tracks.copy()
        tracks[[6, *range(13, 20)], 1:] += (20, 0)
        tracks[2, 2] += (0, 20)
        return Prediction(tracks, np.zeros(tracks.shape[:2], bool), (40, 20))

    assert position_figures(video(points, occluded), ask)["legs_within_16"] == pytest.approx(11.5 / 12)


def test_the_first_frames_are_scored_as_a_clip_of_their_own():
    """What a model of more frames says of the others does not count as a false positive."""
    points, occluded = np.full((1, 7, 2), 100.0), np.zeros((1, 7), bool)
    occluded[:, 4:] = True

    def ask(_: Video, queries: Queries) -> Prediction:
        return Prediction(queries.tracks.copy(), np.zeros(queries.occluded.shape, bool), (40, 20))

    for mode in ("first", "strided"):
        metrics = first_frames_figures(video(points, occluded), ask, frames=4)["metrics"][mode]
        assert (metrics["average_jaccard"], metrics["occlusion_accuracy"]) == (1, 1)
        assert first_frames_figures(video(points, occluded), ask, frames=7)["metrics"][mode]["average_jaccard"] < 1


@pytest.fixture
def tracker(tmp_path: Path) -> Tracker:
    """All points move by `VELOCITY`, and are the more hidden the more frames lie between."""
    return Tracker(write_tiny_model(tmp_path / "m.onnx", num_frames=4, height=10, width=16, clip_name=NAME))


def test_a_mask_is_carried_as_dense_answers_say(tracker: Tracker):
    mask = np.zeros((10, 16), bool)
    mask[:6, :9] = True  # also at the edges, from beyond which what is asked for may have come
    for frame, (carried, seen) in zip((1, 3), carry(tracker, mask, (1, 3), 1), strict=True):
        dense = tracker.dense(frame, to=0)
        y, x = np.indices(mask.shape)
        column, row = (np.rint(each).astype(int) for each in (x + dense.flow[..., 0], y + dense.flow[..., 1]))
        inside = (column >= 0) & (column < 16) & (row >= 0) & (row < 10)
        expected = inside & mask[np.clip(row, 0, 9), np.clip(column, 0, 15)]
        np.testing.assert_array_equal(carried, expected)
        np.testing.assert_array_equal(seen, ~dense.occluded)
        assert 0 < carried.sum() <= mask.sum()
    (fewer, _), (all_pixels, _) = next(carry(tracker, mask, [1], 3)), next(carry(tracker, mask, [1], 1))
    np.testing.assert_array_equal(fewer, all_pixels[::3, ::3])


def test_region_similarity_by_hand(tracker: Tracker):
    """In frame 2 the mask lies three columns on and a row up, of which half is true; in frame 3 all is hidden."""
    masks = np.zeros((4, 10, 16), bool)
    masks[0, 4:8, 2:6] = True
    masks[2, 3:7, 5:9] = True
    masks[2, 3:7, 5:7] = False  # half of it
    masks[3, 8:, :3] = True  # elsewhere
    found = mask_figures(tracker, masks, every=1)
    assert VELOCITY == (1.5, -0.5)
    assert len(found["j"]) == 3
    assert found["j"][1] == 0.5
    assert found["j"][2] == 0
    assert found["j_seen"][1:] == [0.5, 1]  # hidden in frame 3: nothing against nothing


def test_errors_are_of_points_in_sight_but_the_queries_own():
    xy = np.zeros((2, 4, 2))
    occluded = np.array([[0, 0, 0, 1], [1, 0, 0, 0]], bool)
    answers = np.zeros((2, 4, 2), np.float32)
    answers[0, :, 0] = [50, 1, 2, 50]
    answers[1, :, 1] = [50, 50, 4, 8]
    told = np.array([[0, 0, 1, 0], [0, 0, 0, 0]], bool)
    queries = np.zeros((2, 3), np.float32)
    tracks = Tracks(answers, told, told.astype(np.float32), queries, np.arange(4), (20, 40), np.arange(4.0))
    found = precision_figures(tracks, np.array([0, 1]), xy, occluded)
    assert found["in_sight"] == {"points": 4, "median": 3, "p90": pytest.approx(6.8)}
    assert found["told_in_sight"] == {"points": 3, "median": 4, "p90": pytest.approx(7.2)}
    nothing = precision_figures(tracks, np.array([0, 1]), xy, np.ones_like(occluded))
    assert nothing["in_sight"]["points"] == 0


def test_scenery_shows_points_where_its_truth_says():
    clip = Scenery(7, 96, 54, seed=3)
    frames = np.stack([*clip.frames()])
    xy, occluded = clip.truth()
    assert frames.shape == (7, 54, 96, 3)
    inside = (xy > -0.5).all(-1) & (xy < (95.5, 53.5)).all(-1)
    assert not (~occluded & ~inside).any()
    assert not occluded.all(1).any()
    both = ~occluded[:, 2] & ~occluded[:, 4]
    assert both.sum() > 20

    def colours(frame: int, shift: int = 0) -> np.ndarray:
        place = (xy[both, frame] + (0, shift)).astype(np.float32)[None]
        return cv2.remap(frames[frame], place, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[0].astype(float)

    kept = np.median(np.abs(colours(2) - colours(4)))
    assert kept < 0.6 * np.median(np.abs(colours(2) - colours(4, shift=3)))


def test_a_longer_clip_begins_like_a_shorter_one_and_the_camera_travels_on():
    short, long = (Scenery(acts * ACT + 1, 64, 36) for acts in (1, 5))
    ground = []
    for one, other in zip(short._scene.layers, long._scene.layers, strict=True):
        where = [one.warp(0.5).centre, other.warp(0.1).centre]
        assert np.abs(where[0] - where[1]).max() < 0.02  # of a view: 101 frames are a little more than an act
        ground.append([layer.warp(1.0).centre - layer.warp(0.0).centre for layer in (one, other)])
    assert np.linalg.norm(ground[0][1]) > 4 * np.linalg.norm(ground[0][0])
    assert all(np.linalg.norm(far) < 0.7 for _, far in ground[1:])  # objects stay


def test_scenery_is_written_once(tmp_path: Path):
    clip = Scenery(4, 64, 36)
    path = clip.write(tmp_path)
    read = read_clip(path)
    assert (len(read), read.width, read.height) == (4, 64, 36)
    path.write_bytes(b"kept")
    assert clip.write(tmp_path).read_bytes() == b"kept"


ALONE = """
import time
block = b"1" * (150 << 20)
time.sleep(0.6)
"""
PARENT = f"""
import pathlib, subprocess, sys
block = b"1" * (150 << 20)
pathlib.Path(sys.argv[1], "file").write_bytes(block[:1 << 24])
subprocess.run([sys.executable, "-c", {ALONE!r}], check=True)
"""


def test_memory_is_that_of_all_processes_and_disk_that_of_folders(tmp_path: Path):
    taken = measured([sys.executable, "-c", PARENT, str(tmp_path)], [tmp_path])
    for kind in ("peak_rss_gib", "peak_anonymous_gib"):
        assert 0.29 < taken[kind] < 0.45
    assert taken["peak_disk_gib"] == pytest.approx(2**24 / 2**30, abs=0.001)
    assert taken["cpu_seconds"] > 0
    assert taken["seconds"] >= 0.6
    assert "peak_disk_gib" not in measured(toolkit("decomo-track", "--help"))
    with pytest.raises(StageError, match="failed"):
        measured([sys.executable, "-c", "raise SystemExit(3)"])


@pytest.fixture
def shared_folder(tmp_path: Path) -> Path:
    """A clip of the tests in the place of those at full length, with each kind of annotation."""
    clip, here = sliding_square(), tmp_path / "shared" / "data" / "davis480p"
    write_frames(clip, here / "frames" / NAME)
    (here / "masks" / NAME).mkdir(parents=True)
    for number in range(FRAMES):
        mask = np.zeros((HEIGHT, WIDTH), np.uint8)
        mask[10:22, 2 + 2 * number : 14 + 2 * number] = 38
        Image.fromarray(mask).save(here / "masks" / NAME / f"{number:05d}.png")
    truth = np.array([[[8 + 2 * number, 16] for number in range(FRAMES)]]) + 0.5
    occluded = np.zeros((1, FRAMES), bool)
    some = occluded.copy()
    some[:, 1:-1] = True
    (tmp_path / "work").mkdir()
    for kind, hidden in (("joints", occluded), ("ends", some), ("first32", occluded)):
        entry = {"video": clip.frames, "points": truth / (WIDTH, HEIGHT), "occluded": hidden}
        (tmp_path / "work" / f"{kind}.pkl").write_bytes(pickle.dumps({NAME: entry}))
    return tmp_path / "shared"


def test_parts_share_a_fit_and_are_not_measured_again(
    shared_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    settings = [part for override in (*TINY_CPU, *AFFINE) for part in ("--set", override)]
    parts = ["joints", "ends", "first32", "masks", "removal", "crossing"]
    out = tmp_path / "out"
    command = [str(shared_folder), "--out", str(out), "--work", str(tmp_path / "work"), "--clips", NAME]
    command += ["--steps", "2", "--smaller", "4", *settings]
    wanted = [word for part in parts for word in ("--part", part)]
    assert run(footage.main, [*command, *wanted]) == 0
    assert capsys.readouterr().out.count("fits sliding") == 1
    written = {str(path.relative_to(out)) for path in out.rglob("*.json")}
    assert written == {
        *(f"default/{part}/sliding.json" for part in [*parts, "fits"]),
        *(f"chained/{part}/sliding.json" for part in ("joints", "ends")),
    }
    fitted = json.loads((out / "default" / "fits" / "sliding.json").read_text())
    assert (fitted["budget"], fitted["stages"]["train"]["steps"]) == ("--steps 2", 2)
    assert fitted["stages"]["train"]["resumed"] is False
    lines = "\n".join(table(out / "default", out / "chained", tmp_path / "none"))
    for start in ("| joints, < delta_avg, 1 clips | ", "| ends within 4 px, %, 1 tracks | ", "| mask of frame 0 "):
        assert start in lines

    monkeypatch.setattr(plan, "measured", lambda *line: pytest.fail("made again"))
    assert run(footage.main, [*command, *wanted]) == 0
    assert run(footage.main, [*command, "--part", "masks", "--every", "1"]) == 2
    assert "another every" in capsys.readouterr().err
    assert run(footage.main, [str(shared_folder), "--clips", "none", "--out", str(out)]) == 2
    assert "has no clip none; it has sliding" in capsys.readouterr().err
    assert run(footage.main, [*command, "--time-budget", "1m"]) == 2


def test_a_fit_of_several_windows(shared_folder: Path, tmp_path: Path):
    clip = shared_folder / "data" / "davis480p" / "frames" / NAME
    for frame in sorted(clip.iterdir())[FRAMES // 2 :]:  # back again
        copyfile(frame, clip / f"{2 * FRAMES - 1 - int(frame.stem):05d}{frame.suffix}")
    settings = [part for override in (*TINY_CPU, *AFFINE) for part in ("--set", override)]
    out = tmp_path / "out"
    command = [str(shared_folder), "--out", str(out), "--work", str(tmp_path / "work"), "--clips", NAME]
    command += ["--steps", "2", "--window", str(FRAMES), "--smaller", "8", "--part", "removal", *settings]
    assert run(footage.main, command) == 0
    fitted = json.loads((out / "default" / "fits" / "sliding.json").read_text())
    assert fitted["budget"] == f"--steps 2 --window {FRAMES}"
    assert (fitted["stages"]["train"]["windows"], fitted["stages"]["train"]["steps"]) == (2, 4)
    assert (out / "default" / "removal" / "sliding.json").is_file()


def test_a_stopped_fit_goes_on_and_a_failed_one_does_not_stop_other_parts(
    shared_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    asked: list[list[str]] = []

    def fail(line: list[str], *rest: object) -> dict[str, Any]:
        asked.append(line)
        run_folder = Path(line[line.index("--out") + 1])
        run_folder.mkdir(parents=True, exist_ok=True)
        (run_folder / "run.json").touch()
        raise StageError("decomo-train failed")

    monkeypatch.setattr(plan, "measured", fail)
    command = [str(shared_folder), "--out", str(tmp_path / "out"), "--work", str(tmp_path / "work"), "--steps", "2"]
    parts = ["--part", "masks", "--part", "first32"]
    assert run(footage.main, [*command, *parts]) == 2
    assert [("--resume" in line, "--steps" in line) for line in asked] == [(False, True)]  # not tried for each part
    assert "masks sliding, first32 sliding failed" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    assert run(footage.main, [*command, *parts]) == 2
    assert [("--resume" in line, "--steps" in line) for line in asked[1:]] == [(True, False)]


def about(part: str, clip: str, **figures: Any) -> dict[str, Any]:
    machine = {"cores": 2, "processor": "some", "threads": "1"}
    return {"row": part, "clip": clip, "date": "2026-01-02", "commit": "0123abc", "machine": machine, **figures}


def command_taken(seconds: float, memory: float) -> dict[str, float]:
    return {
        "seconds": seconds,
        "cpu_seconds": 2 * seconds,
        "peak_rss_gib": memory,
        "peak_anonymous_gib": memory / 2,
        "peak_disk_gib": 0.25,
    }


def test_a_table_of_records(tmp_path: Path):
    scored = {"first": {"average_pts_within_thresh": 0.5, "average_jaccard": 0.25}}
    better = {"first": {"average_pts_within_thresh": 0.75, "average_jaccard": 0.5}}
    size = {"num_frames": 100, "width": 640, "height": 360}
    commands: dict[str, Any] = {name: command_taken(10, 1.5) for name in ("train", "export", "track", "render")}
    commands["train"] |= {"resumed": True}
    lesser = {name: command_taken(2, 1.25) for name in commands}
    spread = {"points": 1234, "median": 0.75, "p90": 2.0}
    records = [
        about("default/joints", "a", metrics=better, tracks=[0.5, 1.0], legs_within_16=0.75),
        about("default/joints", "b", metrics=scored, tracks=[0.5], legs_within_16=0.25),
        about("chained/joints", "a", metrics=scored, tracks=[0.5, 0.5], legs_within_16=0.5),
        about("chained/joints", "b", metrics=scored, tracks=[0.5], legs_within_16=0.25),
        about("default/ends", "a", errors=[1.0, 6.0]),
        about("chained/ends", "a", errors=[5.0, 20.0]),
        about("default/first32", "a", metrics=better),
        about("reference/cpu", "a", metrics=scored, seed=0),
        about("default/masks", "a", j=[1.0, 0.5], j_seen=[1.0, 0.75], every=2),
        about("default/memory", "c", stages=commands, **size),
        about("default/length", "c", stages=commands, **size),
        about("default/length", "d", stages=lesser, **size | {"num_frames": 10}),
        about("default/precision", "plain", in_sight=spread, told_in_sight=spread | {"median": 0.5}, **size),
        about("default/removal", "a", frames=5, stages={"render": command_taken(1, 1)}, cpu_seconds_per_frame=0.4),
        about("default/crossing", "a", points=4096, windows=10, frames=892, seconds=9, cpu_seconds=9)
        | {"point_frames_per_second": 123456},
    ]
    for record in records:
        file = tmp_path / record["row"] / f"{record['clip']}.json"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps(record))
    lines = list(table(tmp_path / "default", tmp_path / "chained", tmp_path / "reference" / "cpu"))
    for line in (
        "| joints, < delta_avg, 2 clips | 62.5 [50.0, 75.0] | 50.0 [50.0, 50.0] | +12.5 [+0.0, +25.0] |",
        "| joints of legs within 16 px, %, 2 clips | 50.0 [25.0, 75.0] | 37.5 [25.0, 50.0] | +12.5 [+0.0, +25.0] |",
        "| a | 2 | 75.0 | 75.0 [50.0, 100.0] | 75.0 | 50.0 | 50.0 [50.0, 50.0] | 50.0 |",
        "| ends within 4 px, %, 2 tracks | 50.0 [0.0, 100.0] | 0.0 [0.0, 0.0] | +50.0 [+0.0, +100.0] |",
        "| ends, median error, px | 3.5 | 12.5 | -9.0 |",
        "| a | 2 | 50 | 100 | 3.5 | 2 | 0 | 50 | 12.5 |",
        "| first 32 frames, AJ, first, 1 clips | 50.0 | 25.0 | +25.0 |",
        "| mask of frame 0 carried, J, all pixels, 1 clips | 0.750 |  |  |",
        "| 100 frames of 640x360: peak GiB of decomo-track | 1.50 |  |  |",
        "| c | train, the rest of it | 10 | 20 | 1.5 | 0.75 | 0.25 |",
        "| 100 frames of 640x360: seconds a frame | 0.30 | 0.60 (10 frames) | 0.50 times |",
        "| 100 frames of 640x360: peak GiB of disk | 0.25 | 0.25 (10 frames) |  |",
        "| 100 frames of 640x360: median error in px, and told so, plain | 0.50 |  |  |",
        "| plain | 1,234 | 0.75 | 2.00 | 1,234 | 0.50 | 2.00 |",
        "| objects removed, a, 5 frames: processor seconds a frame | 0.40 |  |  |",
        "| 4,096 points through 10 windows, copies of one of a: point-frames a second | 123,456 |  |  |",
        "2026-01-02, commit 0123abc, 2 cores of some, threads: 1",
    ):
        assert line in lines
    assert mean_text([]) == ""


def test_windows_are_copies_that_overlap(tracker: Tracker, tmp_path: Path):
    folder = copied(tracker.path, tmp_path / "copies", windows=3)
    assert Tracker(folder).num_frames == 3 * 4 - 2 * 2
    found = crossing_figures(folder, points=5)
    assert found["frames"] == 8
    assert found["point_frames_per_second"] > 0

"""Corrections from the command line to a new run: what moves, what stays, and what becomes of the old one."""

from __future__ import annotations

import hashlib
import math
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest
import torch

from decomotion import checkpoint
from decomotion.cli import main
from decomotion.clip import Clip, read_clip
from decomotion.config import load
from decomotion.corrections import fit
from decomotion.corrections.fit import _apart, _frame_weights, short
from decomotion.corrections.following import Followed, follow
from decomotion.corrections.points import CorrectedPoint, Place
from decomotion.data.prepare import Preparation
from decomotion.long_clip import windows_of
from decomotion.quality import parse
from decomotion.run import Run
from decomotion.schedule import Schedule, value_at
from decomotion.windows import FILE_NAME
from interruption import ctrl_c, interruption
from tiny_fit import AFFINE, HEIGHT, TINY_CPU, WIDTH, sliding_square, texture, tiny_model, write_frames

FINE = "model.dynamic.conditioner={kind: grid, cells: [2, 8, 16], rank: 24, slope: 1.0}"
"""As the `cpu` preset has it: coarser grids cannot move a place without what is around it."""
SET_TINY = [part for override in (*TINY_CPU, FINE) for part in ("--set", override)]
FRAMES = 10
HEADER = "t,x,y,target_t,target_x,target_y"
POINT, BESIDE, FAR = (1, 9, 15), (1, 9.5, 15), (1, 30, 5)
"""The first two on the square, 2 pixels a frame to the right, the third on the scene."""


@pytest.fixture(autouse=True)
def without_a_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a clip, `sliding`, and its finished fit, `run`."""
    folder = tmp_path_factory.mktemp("fitted")
    clip = write_frames(sliding_square(FRAMES), folder / "sliding")
    assert main([str(clip), "--steps", "60", "--out", str(folder / "run"), "--device", "cpu", *SET_TINY]) == 0
    return folder


def corrected(place: Path, out: Path, *lines: str, steps: int = 100, clip: str = "sliding", run: str = "run") -> int:
    file = out.parent / "given.csv"
    file.write_text("\n".join([HEADER, *lines]) + "\n")
    arguments = [place / clip, "--run", place / run, "--corrections", file, "--out", out, "--steps", steps]
    return main([str(argument) for argument in arguments])


def tracks(run: Path, *points: tuple[float, float, float]) -> Followed:
    return follow(checkpoint.load(run / checkpoint.FILE_NAME).model, np.array(points, float))


def content(folder: Path) -> dict[str, str]:
    return {
        str(file.relative_to(folder)): hashlib.sha256(file.read_bytes()).hexdigest()
        for file in sorted(folder.rglob("*"))
        if file.is_file()
    }


def shifts(place: Path, new: Path, *points: tuple[float, float, float]) -> npt.NDArray[np.floating]:
    """[point, frame, 2]"""
    return tracks(new, *points).xy - tracks(place / "run", *points).xy


def test_a_point_and_its_neighbours_move_and_what_is_far_away_stays(
    place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    before = content(place / "run")
    new = tmp_path / "new"
    assert corrected(place, new, "1,9,15,6,20,15.5") == 0  # the model has it at (19, 15)
    assert capsys.readouterr().out.splitlines() == [f"corrected 1 point of sliding: {place / 'run'}", f"wrote {new}"]
    point, beside, far = shifts(place, new, POINT, BESIDE, FAR)
    assert np.linalg.norm(tracks(new, POINT).xy[0, 6] - (20, 15.5)) < 0.4
    assert beside[6, 0] > 0.4
    assert point[8, 0] > 0.5  # in frames that nobody spoke of
    assert 0 < point[3, 0] < point[6, 0]  # bent, as errors grow
    assert np.linalg.norm(far, axis=-1).max() < 0.1
    assert content(place / "run") == before
    assert (new / "corrections.csv").read_bytes() == (tmp_path / "given.csv").read_bytes()
    quality = parse((new / "quality.json").read_text())
    assert quality.steps == 160


def test_its_time_begins_when_the_clip_is_prepared(place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    waited, prepare, loop = 100.0, fit.prepare_in_stages, Run.loop
    began = []

    def slowly(*given: object, **how: object) -> Preparation:
        now = fit.time.monotonic
        monkeypatch.setattr(fit.time, "monotonic", lambda: now() + waited)
        return prepare(*given, **how)  # type: ignore[arg-type]

    def noted(run: Run, begin: float, *how: object) -> None:
        began.append(fit.time.monotonic() - begin)
        loop(run, begin, *how)  # type: ignore[arg-type]

    monkeypatch.setattr(fit, "prepare_in_stages", slowly)
    monkeypatch.setattr(Run, "loop", noted)
    assert corrected(place, tmp_path / "new", "1,9,15,6,20,15.5", steps=1) == 0
    assert 0 <= began[0] < waited


def test_a_model_that_is_corrected_again_keeps_what_it_was_told(place: Path, tmp_path: Path):
    assert corrected(place, tmp_path / "one", "1,9,15,6,20,15.5") == 0
    arguments = ["--run", str(tmp_path / "one"), "--corrections", str(tmp_path / "given.csv"), "--steps", "60"]
    (tmp_path / "given.csv").write_text(f"{HEADER}\n1,30,5,6,24.5,5\n")
    assert main([str(place / "sliding"), *arguments]) == 0
    assert np.linalg.norm(tracks(tmp_path / "one-corrected", POINT).xy[0, 6] - (20, 15.5)) < 0.5
    config = checkpoint.load(tmp_path / "one" / checkpoint.FILE_NAME).config
    assert short(config) == config
    assert main([str(place / "sliding"), *arguments]) == 0
    assert (tmp_path / "one-corrected-2" / checkpoint.FILE_NAME).is_file()


def test_a_point_is_hidden_where_a_correction_says_so(tmp_path: Path):
    """A bar of the scene passes before the square, and masks say of both that they move: the model takes it for it."""
    clip = sliding_square(FRAMES)
    video, bar = np.array(clip.frames), texture(np.random.default_rng(5), HEIGHT, 4, grain=1.0)
    (tmp_path / "masks").mkdir()
    for t, frame in enumerate(video):
        frame[:, 30 - t : 34 - t] = bar
        mask = np.zeros((HEIGHT, WIDTH), np.uint8)
        mask[10:22, 2 + 2 * t : 14 + 2 * t] = 255
        cv2.imwrite(str(tmp_path / "masks" / f"{t:05d}.png"), mask)
    write_frames(Clip("bar", video, 24.0), tmp_path / "bar")
    fit = ["--steps", "60", "--masks", str(tmp_path / "masks"), "--out", str(tmp_path / "run"), "--device", "cpu"]
    # with own flow the links tell the bar from the square
    plain = [part.replace("alone: true", "alone: false") for part in SET_TINY]
    assert plain != list(SET_TINY)
    assert main([str(tmp_path / "bar"), *fit, *plain]) == 0
    new, point = tmp_path / "new", (1, 12.5, 15)
    assert corrected(tmp_path, new, "1,12.5,15,7,,", clip="bar", steps=150) == 0
    assert tracks(tmp_path / "run", point).occlusion[0, 7] < 0.5 < tracks(new, point).occlusion[0, 7]
    assert tracks(new, point).occlusion[0, :5].max() < 0.5


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("1,9,15,10,20,15", "target_t is 10 but the clip has the frames 0 to 9"),
        ("1,9,15,6,40,15", "outside of the frame"),
        ("", "holds no correction"),
    ],
)
def test_bad_corrections_are_refused_before_any_work(
    place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], line: str, said: str
):
    assert corrected(place, tmp_path / "new", line) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


def test_options_that_do_not_go_together_are_refused(place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    clip, run, file = (str(place / "sliding"), str(place / "run"), str(tmp_path / "given.csv"))
    Path(file).write_text(f"{HEADER}\n1,9,15,6,20,15\n")
    assert main([clip, "--corrections", file]) == 2
    assert "--run and --corrections go together" in capsys.readouterr().err
    assert main([clip, "--run", run, "--corrections", file, "--seed", "3", "--flow", "dis"]) == 2
    assert "leave out --flow, --seed" in capsys.readouterr().err
    assert main([clip, "--run", run, "--corrections", file, "--out", run]) == 2
    assert "exists already" in capsys.readouterr().err
    assert main([clip, "--run", str(tmp_path), "--corrections", file]) == 2
    assert "holds no run" in capsys.readouterr().err
    other = write_frames(sliding_square(8), tmp_path / "other")
    Path(file).write_text(f"{HEADER}\n1,9,15,6,20,15\n")
    assert main([str(other), "--run", run, "--corrections", file]) == 2
    assert "another clip" in capsys.readouterr().err


def test_a_corrected_run_is_not_resumed(place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert corrected(place, tmp_path / "new", "1,9,15,6,20,15", steps=2) == 0
    assert main([str(place / "sliding"), "--out", str(tmp_path / "new"), "--resume", "--steps", "9"]) == 2
    assert "made by corrections" in capsys.readouterr().err


def test_nothing_is_left_of_a_correction_that_is_stopped(place: Path, tmp_path: Path):
    with interruption(3, ctrl_c):
        assert corrected(place, tmp_path / "new", "1,9,15,6,20,15", steps=100_000) == 130
    assert [path.name for path in tmp_path.iterdir()] == ["given.csv"]


def test_of_several_windows_those_that_are_told_something_change(tmp_path: Path):
    picture = texture(np.random.default_rng(0), HEIGHT, WIDTH + 20, grain=1.5)
    frames = write_frames(
        Clip("long", np.stack([picture[:, x : x + WIDTH] for x in range(20)]), 24.0), tmp_path / "long"
    )
    clip, run = read_clip(frames), tmp_path / "run"
    layout = windows_of(clip, 8, [])
    tiny = [part for override in (*TINY_CPU, *AFFINE) for part in ("--set", override)]
    for each in layout.windows:
        fit = ["--steps", "2", "--out", str(run / each.name), "--device", "cpu", *tiny]
        assert main([f"{frames}@{each.begin}:{each.end}", *fit]) == 0
    layout.save(run / FILE_NAME, digest=clip.digest(), options=[])
    before = content(run)
    first, second, *_ = layout.windows
    line = f"{second.end - 2},20,14,{first.begin + 1},24,15"
    assert corrected(tmp_path, tmp_path / "new", line, steps=2, clip="long") == 0
    after = content(tmp_path / "new")
    assert content(run) == before
    changed = {name.split("/")[0] for name in before if after.get(name) != before[name]}
    assert changed == {first.name, second.name}
    assert {"corrections.csv", "windows.json", f"{second.name}/corrections.csv"} <= set(after)
    longer = [str(frames), "--out", str(tmp_path / "new"), "--resume", "--steps", "9"]
    assert main(longer) == 2


def test_frames_that_are_spoken_of_are_drawn_as_often_again_as_all() -> None:
    """Frame 3 is known of two points, 5 and 8 of one, 8 as hiding it: of four, half and a quarter each."""
    points = [
        CorrectedPoint.of([Place(3, 1, 2), Place(5, 4, 2)]),
        CorrectedPoint.of([Place(3, 9, 9), Place(8, math.nan, math.nan)]),
    ]
    weights = _frame_weights(points, FRAMES)
    expected = np.full(FRAMES, 0.05)
    expected[[3, 5, 8]] += [0.25, 0.125, 0.125]
    np.testing.assert_allclose(weights, expected)


def test_a_short_fit_begins_as_the_long_one_did_and_learns_from_all_gaps() -> None:
    config = load("cpu")
    brief = short(config)
    scheduled = {name: weight for name, weight in config.loss.items() if isinstance(weight, Schedule)}
    assert scheduled, "the preset has losses that come or go"
    for name, weight in config.loss.items():
        assert brief.loss[name] == (weight.value if isinstance(weight, Schedule) else weight)
    assert all(value_at(brief.optim.gap, progress) == 1 for progress in (0.0, 0.3, 1.0))
    assert (brief.optim.warmup, brief.optim.decay) == (0.05, "cosine")
    assert brief.model == config.model
    assert short(brief) == brief


def test_how_far_corrections_are_met(monkeypatch: pytest.MonkeyPatch) -> None:
    """A point's first place is where it is asked for, and met by itself."""
    xy = np.zeros((1, FRAMES, 2), np.float32) + np.array([10, 20], np.float32)
    occlusion = np.full((1, FRAMES), 0.4, np.float32)
    occlusion[0, 8] = 0.6
    monkeypatch.setattr("decomotion.corrections.fit.follow", lambda *_: Followed(xy, occlusion))
    points = [
        CorrectedPoint.of([Place(3, 70, 20), Place(5, 13, 24), Place(7, math.nan, math.nan)]),
        CorrectedPoint.of([Place(2, 10, 20), Place(6, 10, 21), Place(8, math.nan, math.nan)]),
    ]
    model = tiny_model("cpu", frames=FRAMES, height=HEIGHT, width=WIDTH, feature_size=1)
    apart, hidden = _apart(model, points)
    np.testing.assert_allclose(apart, [5, 1])
    assert hidden == 1

"""The calibration of expected errors: numbers that were put in come out again, and clips that are left out are."""

from __future__ import annotations

import json
import pickle
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import calibration
from calibration import diagram, document, main, report
from decomo_runtime.expected_error import TAIL, Calibration
from decomotion.console import run
from decomotion.images import png
from decomotion.windows import FILE_NAME, Windows, split
from harness.answers import Answers, model_paths
from harness.told_errors import Told, fit, left_out
from tiny_model import VELOCITY, write_tiny_model

TRUTH = Calibration(0.8, (0.001, 0.1, 0.95), (0.3, 1.0, 20.0), 0.3, 0.5, 0.25, 0.5)
"""Errors' 80 % quantile, by score; that of what is refined is half."""


def answers(
    clip: str, medians: Sequence[float | None] = (None,), count: int = 4000, scale: float = 1.0
) -> list[Answers]:
    """Of one clip's models: errors whose quantile is `scale` times what TRUTH says."""
    found = []
    for number, median in enumerate(medians):
        chance = np.random.default_rng([*clip.encode(), number])
        score, gap = chance.uniform(0, 1, count) ** 3, chance.integers(1, 30, count)
        quantile = scale * TRUTH.error(score, gap, median).astype(np.float64)
        error = quantile * np.exp(0.5 * (chance.normal(size=count) - 0.8416))  # 80 % of a normal law are below 0.8416
        refined = np.where(chance.random(count) < 0.5, 0.5 * error, np.nan)
        found.append(Answers(clip, "30 of 36x24", median, score, gap, error, refined))
    return found


def test_numbers_come_out_as_they_were_put_in():
    fitted = fit([*answers("a"), *answers("b")])
    assert fitted.gap_power == pytest.approx(0.3, abs=0.05)
    assert fitted.quality_power == 0  # nothing tells
    assert fitted.refined_factor == pytest.approx(0.5, abs=0.05)
    assert fitted.clips == ("a", "b")
    score, gap = np.array([0.002, 0.02, 0.2, 0.6]), np.full(4, 10)
    np.testing.assert_allclose(fitted.error(score, gap, None), TRUTH.error(score, gap, None), rtol=0.2)


def test_the_quality_of_fits_is_learned_from_where_enough_clips_tell():
    medians = {"a": 0.05, "b": 0.25, "c": 1.25}
    fitted = fit([each for clip, median in medians.items() for each in answers(clip, [median])])
    assert fitted.quality_power == 0.5
    assert fitted.typical_median == pytest.approx(0.25)
    assert fit([*answers("a", [0.05]), *answers("b", [1.25])]).quality_power == 0


def test_a_clip_weighs_the_same_whatever_its_number_of_models():
    one, many = answers("far", scale=4.0), [*answers("near", [None] * 3)]
    fitted = fit([*one, *many])
    within = [np.mean(each.error <= each.told(fitted)) for each in (one[0], many[0])]
    assert np.mean(within) == pytest.approx(0.8, abs=0.03)


def test_the_curve_does_not_fall():
    rows = answers("a")[0]
    error = np.where(rows.score > 0.4, 0.01, rows.error)
    fitted = fit([Answers("a", "a", None, rows.score, rows.gap, error, rows.refined_error)])
    assert (np.diff(fitted.errors) >= 0).all()


def test_clips_are_told_by_the_others():
    """Of two clips, one four times worse: each is told what the other one is."""
    near, far = left_out([*answers("near"), *answers("far", scale=4.0)])
    assert np.mean(near.answers.error <= near.error) > 0.97
    assert np.mean(far.answers.error <= far.error) < 0.2
    np.testing.assert_allclose(near.refined_error, 0.5 * near.error, rtol=0.1)


def test_report_of_what_is_right():
    record = report(left_out([*answers("a"), *answers("b"), *answers("c")]))
    assert record["within"] == pytest.approx(0.8, abs=0.02)
    assert record["refined"]["within"] == pytest.approx(0.8, abs=0.04)
    assert record["refined"]["share_of_answers"] == pytest.approx(0.5, abs=0.02)
    assert sum(each["share_of_answers"] for each in record["bins"]) == pytest.approx(1)
    assert all(each["within"] == pytest.approx(0.8, abs=0.05) for each in record["bins"] if each["by_clip"])
    kept = [each["kept"] for each in record["limits"]]
    assert kept == sorted(kept)
    assert all(each["within"] > each["within_of_all"] for each in record["limits"])
    lines = list(document(record))
    assert f"| all | 100% | {record['within']:.0%} |" in lines
    figure = diagram(record)
    drawn = {line.get_label(): line.get_ydata() for line in figure.axes[0].get_lines()}
    assert {"a", "b", "c", "all"} <= drawn.keys()
    json.dumps(record)


def test_chances_are_what_was_within():
    """Of errors that are spread as the rule has it; the power that they were spread by comes out."""
    for tail in (1.5, 2.0):
        chance = np.random.default_rng(3)
        quantile = np.exp(chance.normal(1, 0.8, 20000))
        drawn = chance.uniform(size=20000)
        error = quantile * (drawn / (1 - drawn) / 4) ** (1 / tail)
        none = np.full(20000, np.nan)
        told = Told(Answers("a", "a", None, none, np.ones(20000, np.int64), error, none), quantile, none)
        record = report([told])
        assert record["tail"] == pytest.approx(tail, abs=0.11)
        if tail == TAIL:
            for each in record["chances"]:
                assert each["near"] == pytest.approx(each["chance"], abs=0.05)


def test_files_and_folders_of_windows_are_models(tmp_path: Path):
    size = {"num_frames": 6, "height": 12, "width": 18}
    alone = write_tiny_model(tmp_path / "x" / "alone.onnx", **size)
    windows = split(10, [], 6)
    for window in windows:
        write_tiny_model(tmp_path / "x" / "long" / f"{window.name}.onnx", **size)
    Windows("walk", 10, 12, 18, 25.0, windows).save(tmp_path / "x" / "long" / FILE_NAME)
    assert sorted(model_paths([tmp_path / "x"])) == [alone, tmp_path / "x" / "long"]
    assert model_paths([tmp_path / "x" / "long"]) == [tmp_path / "x" / "long"]
    assert model_paths([alone]) == [alone]


def test_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """Two clips whose points move as the tiny model says, but for a pixel to the right."""
    frames, height, width = 7, 24, 36
    chance = np.random.default_rng(0)
    time = np.arange(frames)[:, None]
    dataset = {}
    for clip in ("a", "b"):
        start = chance.uniform(8, 16, (30, 1, 2))
        xy = start + time * np.array(VELOCITY)
        xy[:, 1:, 0] += 1
        dataset[clip] = {
            "video": [png(chance.integers(0, 256, (height, width, 3), np.uint8)) for _ in range(frames)],
            "points": ((xy + 0.5) / (width, height)).astype(np.float32),
            "occluded": np.zeros((30, frames), bool),
        }
        model = tmp_path / "models" / f"{clip}.onnx"
        write_tiny_model(model, num_frames=frames, height=height, width=width, clip_name=clip)
    write_tiny_model(tmp_path / "models" / "z.onnx", num_frames=9, height=height, width=width, clip_name="a")
    (tmp_path / "two.pkl").write_bytes(pickle.dumps(dataset))
    monkeypatch.setattr(calibration, "PICKLES", ("two.pkl",))
    monkeypatch.setattr(calibration, "KINDS", ())
    numbers = tmp_path / "numbers.json"
    monkeypatch.setattr(calibration, "FILE", numbers)
    out, picture = tmp_path / "out", tmp_path / "reliability.png"
    asked = [str(tmp_path), str(tmp_path / "models"), "--out", str(out), "--diagram", str(picture)]
    assert run(main, asked) == 0
    assert not numbers.exists()
    printed = capsys.readouterr().out
    assert "no annotations of a with 9 frames" in printed
    record = json.loads((out / "calibration.json").read_text())
    assert [each["clip"] for each in record["models"]] == ["a", "b"]
    assert record["models"][0]["frames"] == "7 of 36x24"
    side = 36 / 256
    assert record["models"][0]["median_error"] == pytest.approx(1 / side, rel=0.01)
    assert picture.stat().st_size > 1000
    assert "| all | 100% | " in (out / "calibration.md").read_text()
    assert run(main, [*asked[:4], "--write"]) == 0
    assert Calibration.load(numbers).clips == ("a", "b")
    assert run(main, [str(tmp_path), str(tmp_path / "models" / "a.onnx"), "--out", str(out)]) == 2
    assert "give models of two clips or more" in capsys.readouterr().err

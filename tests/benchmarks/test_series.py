"""Rows from YAML, records that a series resumes by, and whole programs on a clip in seconds."""

from __future__ import annotations

import json
import math
from pathlib import Path

import click
import numpy as np
import pytest

import accuracy
import baselines
import plots
import supplied
import table
from decomo_eval.predictions import Prediction
from decomotion import config as configuration
from decomotion.console import run
from decomotion.data.flow import build_flow
from decomotion.data.links.intervals import pairs_of
from decomotion.data.masks.folder import read_masks
from harness import clips, records
from harness.series import Row, read_series
from harness.usage import StageError
from tiny_fit import AFFINE, TINY_CPU, sliding_square, write_truth

SPLITS = {"static", "dynamic", "visible", "reappeared", "out_of_frame"}
SERIES = sorted((Path(accuracy.__file__).parent / "series").glob("*.yaml"))


@pytest.mark.parametrize("path", SERIES, ids=lambda path: path.stem)
def test_committed_series_describe_valid_configurations(path: Path):
    """Without overrides that have gone out of date; no row is there twice."""
    digests = [records.config_digest(row.config()) + str(row.settings()) for row in read_series(path).rows]
    assert len(set(digests)) == len(digests)


def test_defaults_are_of_rows_that_do_not_say_otherwise(tmp_path: Path):
    path = tmp_path / "one.yaml"
    path.write_text("defaults: {time_budget: 3m, clips: [a]}\nrows: [{name: x}, {name: y, clips: [b], seeds: [0, 1]}]")
    x, y = read_series(path).rows
    assert (x.clips, y.clips, x.time_budget, y.seeds) == (("a",), ("b",), "3m", (0, 1))


def test_a_row_names_files_by_clip():
    row = Row(name="x", steps=1, overrides=("data.masks=supplied/{clip}/masks", "data.features=none"))
    assert row.on("goat").overrides == ("data.masks=supplied/goat/masks", "data.features=none")
    assert row.on("goat").config().data.masks == "supplied/goat/masks"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("rows: [{name: x}]", "either a time_budget or a number of steps"),
        ("rows: [{name: x, steps: 1, time_budget: 3m}]", "either a time_budget or a number of steps"),
        ("rows: [{name: x, steps: 1}, {name: x, steps: 2}]", "two rows have one name"),
        ("rows: [{name: a b, steps: 1}]", "rows.0.name"),
        ("rows: [{name: x, steps: 1, budget: 2}]", "rows.0.budget"),
        ("- x", "is not a series"),
        ("rows: {", "is not a series"),
    ],
)
def test_a_bad_series_is_named(text: str, words: str, tmp_path: Path):
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    with pytest.raises(click.UsageError, match=words):
        read_series(path)


def test_records_of_another_configuration_stop_a_series(tmp_path: Path):
    path = tmp_path / "row" / "clip-seed0.json"
    assert not records.is_done(path, {"config": "a"})
    records.write_record(path, {"config": "a", "metrics": {"strided": {"x": math.nan}}})
    assert json.loads(path.read_text())["metrics"]["strided"]["x"] is None
    assert records.is_done(path, {"config": "a"})
    with pytest.raises(click.ClickException, match="made with another config; move"):
        records.is_done(path, {"config": "b"})
    assert set(records.read_records(tmp_path)) == {"row"}


class TestClips:
    def test_procedural(self):
        found = clips.read_clips("procedural", ["seed3"])
        video, masks = found["seed3"].video, found["seed3"].object_masks
        assert (video.name, video.num_frames, video.height, video.width) == ("seed3", 32, 256, 256)
        assert masks is not None
        assert masks.shape == (32, 256, 256)
        assert masks.any()
        perfect = records.score_clip(
            found["seed3"], lambda queries: Prediction(queries.tracks, queries.occluded, (256, 256))
        )
        assert perfect["metrics"]["strided"]["average_jaccard"] == 1
        for mode in ("strided", "first"):
            assert set(perfect["splits"][mode]) == SPLITS
            outside = perfect["splits"][mode].pop("out_of_frame")
            assert outside["count"] == 0 or outside["occlusion_accuracy"] == 1
            for split in perfect["splits"][mode].values():
                assert split["average_pts_within_thresh"] == 1
                assert split["count"] > 0

    def test_names_that_are_none(self, tmp_path: Path):
        with pytest.raises(click.UsageError, match="named seed<number>"):
            clips.read_clips("procedural", ["goat"])
        dataset = write_truth(sliding_square(), tmp_path / "truth.pkl")
        with pytest.raises(click.UsageError, match="has no clip goat; it has sliding"):
            clips.read_clips(str(dataset), ["goat"])


@pytest.fixture
def dataset(tmp_path: Path) -> list[str]:
    """Arguments: a dataset of one tiny clip, and masks that split its points."""
    clip = sliding_square()
    masks = np.zeros(clip.frames.shape[:3], bool)
    masks[:, 8:22] = True
    np.savez(tmp_path / "masks.npz", sliding=masks)
    truth = write_truth(clip, tmp_path / "truth.pkl")
    return [str(truth), "--object-masks", str(tmp_path / "masks.npz")]


def test_supplied_files_are_such_as_preparation_takes(dataset: list[str], tmp_path: Path):
    truth, _, masks = dataset
    assert run(supplied.main, [truth, masks, str(tmp_path / "out")]) == 0
    clip = clips.read_clips(truth, None, Path(masks))["sliding"]
    frames, height, width = clip.video.num_frames, clip.video.height, clip.video.width
    here = tmp_path / "out" / "sliding"
    masks = list(read_masks(here / "masks", frames, height, width))
    np.testing.assert_array_equal(masks, clip.object_masks)
    settings = f"{{kind: folder, path: '{here}/flow', field_side: 512, intervals: geometric, longest_interval: 8}}"
    flow = build_flow(configuration.load("cpu", overrides=(f"data.flow={settings}",)).data.flow)
    flow.require(pairs_of(tuple(gap for gap in supplied.GAPS if gap < frames), frames))
    assert flow(clip.video.frames()[0], clip.video.frames()[1], (0, 1)).shape == (height, width, 2)


def test_baselines_then_tables_and_plots(dataset: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "results"
    command = [*dataset, "--set", "data.flow.intervals=[1,2]", "--out", str(out)]
    assert run(baselines.main, command) == 0
    assert capsys.readouterr().out.count(" sliding: AJ ") == 3
    assert run(baselines.main, command) == 0  # everything is there
    assert capsys.readouterr().out == ""
    assert run(baselines.main, [*dataset, "--set", "data.flow.upsample=1", "--out", str(out)]) == 2
    assert "made with another overrides and config" in capsys.readouterr().err
    assert (
        run(
            baselines.main,
            [*dataset, "--methods", "prepared", "--set", "data.pool.points_per_frame=500", "--out", str(out)],
        )
        == 0
    )
    assert capsys.readouterr().out.startswith("prepared-dis sliding: AJ 0.")

    baseline = ["--baseline", str(out / "chained-dis")]
    assert run(table.main, [str(out), *baseline]) == 0
    head, rule, *rows = capsys.readouterr().out.splitlines()
    assert {line.count("|") for line in (head, rule, *rows)} == {head.count("|")}
    assert [row.split(" | ")[0] for row in rows] == [
        f"| {row}-dis" for row in ("chained", "direct", "linked", "prepared")
    ]
    assert rows[0].endswith("| +0.0 | +0.0 | sliding, +0.0 |")
    assert run(table.main, [str(out / "chained-dis"), "--by", "clip", *baseline]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(" | ")[0] for line in lines[-2:]] == ["| sliding", "| **mean**"]
    assert all(line.endswith("| +0.0 | +0.0 |") for line in lines[-2:])

    assert run(plots.main, ["clips", str(tmp_path / "clips.png"), str(out)]) == 0
    assert (tmp_path / "clips.png").read_bytes().startswith(b"\x89PNG")
    assert run(plots.main, ["budget", str(tmp_path / "budget.png"), str(out)]) == 2
    assert run(table.main, [str(tmp_path / "results" / ".." / "empty")]) == 2


def test_a_fit_is_recorded_and_not_made_again(
    dataset: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    """Train and export as commands of their own, two steps."""
    series = tmp_path / "tiny.yaml"
    series.write_text(
        f"rows: [{{name: tiny, steps: 2, rebuild_cache: false, overrides: {json.dumps([*TINY_CPU, *AFFINE])}}}]"
    )
    out = tmp_path / "results"
    command = [*dataset, "--series", str(series), "--out", str(out), "--work", str(tmp_path / "work")]
    assert run(accuracy.main, command) == 0
    record = json.loads((out / "tiny" / "sliding-seed0.json").read_text())
    assert (record["row"], record["clip"], record["seed"], record["steps"]) == ("tiny", "sliding", 0, 2)
    assert set(record["stages"]) == {"prepare", "train", "export", "score"}
    assert record["stages"]["train"]["steps"] == 2
    assert 0.1 < record["stages"]["train"]["peak_rss_gib"] < 10
    assert set(record["splits"]["strided"]) == SPLITS
    assert record["commit"]
    assert record["model_bytes"] > 0
    assert record["quality"]["steps"] == 2
    monkeypatch.setattr(accuracy, "measured", lambda *command: pytest.fail("made again"))
    capsys.readouterr()
    assert run(accuracy.main, command) == 0
    assert "1 fits, 1 of them done" in capsys.readouterr().out


def test_a_failed_fit_does_not_stop_the_others(
    dataset: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    tried = []

    def fail(job: accuracy.Job, *rest: object) -> records.Record:
        tried.append(job.seed)
        raise StageError("decomo-train failed")

    monkeypatch.setattr(accuracy, "fit", fail)
    assert run(accuracy.main, [*dataset, "--seeds", "0,1", "--out", str(tmp_path / "results")]) == 2
    assert tried == [0, 1]
    assert "2 of 2 fits failed" in capsys.readouterr().err
    assert not (tmp_path / "results").exists()


def test_a_row_is_a_row_of_the_preset():
    assert Row(name="x", steps=3, overrides=("model.volumes=static",)).config().model.volumes == "static"

"""The programs behind the figures of `decomo-eval` and `decomo-bench`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import accuracy
import baselines
import development
import footage
import scoring
import workers
from decomotion.console import run
from decomotion.errors import TrainingError
from decomotion.jobs import clip_task
from tiny_fit import sliding_square, write_truth

OFFICIAL = """
import tensorflow_that_is_not_installed
def compute_tapvid_metrics(
    query_points: np.ndarray, gt_occluded, gt_tracks, pred_occluded, pred_tracks, query_mode: str
) -> Mapping[str, np.ndarray]:
    assert query_mode == 'strided'
    counted = np.arange(gt_occluded.shape[2]) != query_points[..., :1]
    return {'occlusion_accuracy': np.sum((pred_occluded == gt_occluded) & counted, (1, 2)) / np.sum(counted, (1, 2))}
"""


def test_scoring_is_timed_against_a_function_of_a_file_whose_libraries_are_absent(tmp_path: Path):
    source, record = tmp_path / "official.py", tmp_path / "record.json"
    source.write_text(OFFICIAL)
    size = ["--videos", "2", "--queries", "20", "--frames", "6"]
    assert run(scoring.main, [str(source), *size, "--json", str(record)]) == 0
    written = json.loads(record.read_text())
    assert written["times_as_fast"] == pytest.approx(
        written["official_seconds"] / written["seconds"], rel=0.1, abs=0.006
    )
    source.write_text(OFFICIAL.replace("==", "!="))  # other numbers are no comparison
    with pytest.raises(AssertionError):
        run(scoring.main, [str(source), *size])
    source.write_text("import numpy")
    assert run(scoring.main, [str(source)]) == 2


def record(row: str, dataset: str, clip: str, aj: float, seed: int) -> dict[str, Any]:
    metrics = {mode: {"average_jaccard": aj, "average_pts_within_thresh": aj} for mode in ("strided", "first")}
    about = {
        "date": "2026-01-02",
        "commit": "0123abc",
        "overrides": ["data.flow.upsample=1"],
        "machine": {"cores": 2, "processor": "some", "threads": "1"},
        "stages": {},
        "splits": {},
    }
    return {"row": row, "dataset": dataset, "clip": clip, "seed": seed, "steps": 40, "metrics": metrics, **about}


def test_the_full_table_is_of_all_programs_records(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Their own options, as they take them; their work is tested elsewhere."""
    out, asked = tmp_path / "results", []
    (tmp_path / "data").mkdir()
    for group in (development.TEN, development.FIVE):
        (tmp_path / "data" / development.MASKS.format(group)).touch()

    def write(options: dict[str, Any], row: str, clip: str, aj: float, seed: int = 0) -> None:
        folder, dataset = options["out"] / row, Path(options["dataset"]).name
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{clip}-seed{seed}.json").write_text(json.dumps(record(row, dataset, clip, aj, seed)))

    def fit(**options: Any) -> None:
        asked.append(options)
        clip = "judo" if "dev2" in options["dataset"] else "goat"
        match options["series"].stem:
            case "like-steps":
                write(options, "steps-1200", clip, 0.5)
            case "seeds":
                write(options, "cpu", "car-shadow", 0.75)
            case "pole":
                write(options, "cpu", "car-shadow", 0.25, 3)
                raise TrainingError("one of the fits failed")

    def flow(**options: Any) -> None:
        asked.append(options)
        clip = "judo" if "dev2" in options["dataset"] else "goat"
        for method in options["methods"].split(","):
            write(options, f"{method}-{options['flows']}", clip, 0.375)

    def whole(**options: Any) -> None:
        asked.append(options)

    for program, callback in ((accuracy, fit), (baselines, flow), (footage, whole)):
        monkeypatch.setattr(program.main, "callback", callback)
    command = [str(tmp_path), "--out", str(out)]
    assert run(development.main, command) == 1  # and the tables are there
    assert [Path(each["dataset"]).stem for each in asked] == [
        f"tapvid_davis32_{group}" for group in ("dev", "dev", "dev2", "dev2", "dev", "dev2", "dev", "dev")
    ]
    assert [each["methods"] for each in asked[:4]] == ["chained,direct,linked", "prepared", "chained", "prepared"]
    assert [each["overrides"] for each in asked[:4]] == 2 * [(development.FINE,), (development.GAPS,)]
    assert [each["series"].stem for each in asked[4:]] == ["like-steps", "like-steps", "seeds", "pole"]
    tables = (out / "development.md").read_text()
    ten, five = tables.index("## ten clips, strided"), tables.index("## five further clips, strided")
    assert "| steps-1200 | 1 | 50.0 | 50.0 |" in tables[ten:five]
    assert "| steps-1200 | 1 | 50.0 | 50.0 |" in tables[five:]
    assert "| +12.5 |" in tables[ten:five]
    assert "| cpu | 1 | 75.0 | 75.0 |" in tables[ten:five]
    for row in ("chained-dis", "direct-dis", "linked-dis", "prepared-dis"):
        assert f"| {row} | 1 | 37.5 " in tables[ten:five]
        assert (f"| {row} | 1 | 37.5 " in tables[five:]) == (row in ("chained-dis", "prepared-dis"))
    assert "| 0 | 75.0 |" in tables[tables.index("## car-shadow") :]
    assert "| 3 | 25.0 |" in tables[tables.index("## car-shadow") :]
    assert "| cpu | 2026-01-02 | 0123abc | 40 steps data.flow.upsample=1 | 2 cores of some | 1 |" in tables

    asked.clear()
    (out / "development.md").unlink()
    assert run(development.main, [*command, "--only", "table"]) == 0
    assert not asked
    assert (out / "development.md").read_text() == tables
    assert run(development.main, [*command, "--only", "footage"]) == 0
    assert [each["parts"] for each in asked] == [("joints", "ends", "first32")]


def test_workers_are_compared_on_the_same_videos(tiny_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A fit that is copied, and an export that is drawn up: what is counted and compared is real."""
    train = f"import shutil, sys; shutil.copytree({str(tiny_run)!r}, sys.argv[3])"
    export = f"""
import pathlib, sys
sys.path.insert(0, {str(Path(__file__).parents[1])!r})
from tiny_model import write_tiny_model
write_tiny_model(pathlib.Path(sys.argv[1]), num_frames=8, width=40, height=28, clip_name="sliding")
"""
    monkeypatch.setattr(clip_task, "COMMANDS", {"train": ("-c", train), "export": ("-c", export)})
    monkeypatch.setenv("DECOMO_CACHE", "")  # so that it is put back
    truth = write_truth(sliding_square(), tmp_path / "truth.pkl")
    assert run(workers.main, [str(truth), "--time-budget", "2s", "--json", str(tmp_path / "record.json")]) == 0
    written = json.loads((tmp_path / "record.json").read_text())
    one, two = written["workers"]["1"], written["workers"]["2"]
    assert (one["videos"], one["steps_per_video"], written["steps_share"]) == (1, 20, 1)
    assert one["mean"] == two["mean"]
    assert written["speed_up"] == pytest.approx(one["seconds"] / two["seconds"], rel=0.2, abs=0.01)

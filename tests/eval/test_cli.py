"""The command: what it prints, what it writes, and its exit codes."""

from __future__ import annotations

import json
import math
import pickle
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from decomo_eval.cli import main
from full_disk import writes_end_at

WritePredictions = Callable[..., Path]


def test_scores_are_printed_and_written(
    dataset: Path, write_predictions: WritePredictions, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, out = write_predictions("left", "right"), tmp_path / "scores" / "out.json"
    assert main(["tapvid", str(dataset), "--predictions", str(folder), "--json", str(out)]) == 0
    printed = capsys.readouterr().out.splitlines()
    assert printed[0].split() == ["AJ", "<", "delta_avg", "OA", "TC", "px"]
    assert printed[1].split() == ["left", "100.0", "100.0", "100.0", "0.00"]
    assert printed[3].split() == ["mean", "100.0", "100.0", "100.0", "0.00"]
    assert printed[-3] == "AJ after re-detection 100.0, survival 100.0, median trajectory error 0.00 px"
    assert printed[-2] == ("strided, mean over 2 of 2 videos: AJ 100.0, < delta_avg 100.0, OA 100.0, TC 0.00 px")
    assert printed[-1] == f"wrote {out}"
    written = json.loads(out.read_text())
    assert list(written) == [
        *("dataset", "query_mode", "tracker", "resolution"),
        *("videos", "mean", "interval", "splits", "missing", "undefined", "without_masks", "figures"),
    ]
    assert written["dataset"] == str(dataset)
    assert written["query_mode"] == "strided"
    assert written["mean"]["average_jaccard"] == 1
    assert written["videos"]["right"]["jaccard_16"] == 1
    assert list(out.parent.iterdir()) == [out]


@pytest.mark.parametrize("option", ["--json", "--report", "--plots", "--overlay"])
def test_a_place_that_cannot_be_written_is_found_first(
    option: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setattr("decomo_eval.scoring.evaluate", lambda *_, **__: pytest.fail("it began"))
    assert main(["tapvid", "none.pkl", "--predictions", "none", option, str(tmp_path / "file" / "a")]) == 2
    assert capsys.readouterr().err.startswith(f"Error: {option} {tmp_path / 'file' / 'a'} cannot be written")


@pytest.mark.parametrize("option", ["--json", "--report", "--plots", "--overlay"])
def test_a_full_disk(
    option: str,
    dataset: Path,
    write_predictions: WritePredictions,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder, out = write_predictions("left", "right"), tmp_path / "new" / "a"
    with writes_end_at(100):
        assert main(["tapvid", str(dataset), "--predictions", str(folder), option, str(out)]) == 2
    said = capsys.readouterr().err.split("\r")[-1]
    assert said.startswith(f"Error: {out}")
    assert said.endswith(": File too large\n")
    assert said.count("\n") == 1
    assert not [path for path in out.parent.rglob("*") if path.is_file()]


def test_absent_and_undefined_videos_are_named(
    dataset: Path,
    dataset_content: dict[str, Any],
    write_predictions: WritePredictions,
    capsys: pytest.CaptureFixture[str],
) -> None:
    dataset_content["left"]["occluded"][:, 1:] = True
    dataset.write_bytes(pickle.dumps(dataset_content))
    assert main(["tapvid", str(dataset), "--predictions", str(write_predictions("left"))]) == 0
    printed = capsys.readouterr().out
    assert "not scored, no file in the folder (1): right" in printed
    assert "left out of the mean where -, no point to count (1): left" in printed
    assert "mean over 1 of 2 videos: AJ -, < delta_avg -, OA 100.0, TC - px" in printed


def test_videos_without_object_masks_are_named(
    dataset: Path, write_predictions: WritePredictions, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    np.savez(tmp_path / "masks.npz", left=np.ones((11, 5, 8), bool))
    folder, page = write_predictions("left", "right"), tmp_path / "report" / "index.html"
    options = ["--object-masks", str(tmp_path / "masks.npz"), "--report", str(page.parent)]
    assert main(["tapvid", str(dataset), "--predictions", str(folder), *options]) == 0
    assert "without object masks (1): right" in capsys.readouterr().out
    assert "Without object masks (1):" in page.read_text()


def test_chosen_videos_and_mode(
    dataset: Path, write_predictions: WritePredictions, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = str(write_predictions("left", "right", query_mode="first"))
    options = ["--query-mode", "first", "--videos", " right, right,"]
    assert main(["tapvid", str(dataset), "--predictions", folder, *options]) == 0
    assert "first, mean over 1 of 1 videos" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["{dataset}"], "give either models, a folder of <video>.onnx, or predictions"),
        (["{dataset}", "--models", "x", "--predictions", "x"], "give either"),
        (["{dataset}", "--models", "nowhere"], "nowhere has no left.onnx, right.onnx"),
        (["{dataset}", "--predictions", "{folder}", "--videos", "right"], "has no right.npz"),
        (["{dataset}", "--predictions", "{folder}", "--videos", "up"], "has no video up; it has left, right"),
        (["{dataset}", "--predictions", "{folder}", "--videos", ","], "no video is named"),
        (["{dataset}", "--predictions", "{folder}", "--query-mode", "dense"], "'dense' is not one of"),
        (["{dataset}", "--predictions", "{folder}", "--query-mode", "first"], "other mode"),
        (["nowhere.pkl", "--predictions", "{folder}"], "nowhere.pkl cannot be opened"),
        (
            ["{dataset}", "--predictions", "{folder}", "--json", "{dataset}/x.json"],
            "dataset.pkl/x.json cannot be written",
        ),
    ],
)
def test_bad_input_is_one_sentence_and_exit_code_2(
    dataset: Path,
    write_predictions: WritePredictions,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    words: str,
) -> None:
    places = {"dataset": dataset, "folder": write_predictions("left")}
    assert main(["tapvid", *(argument.format(**places) for argument in arguments)]) == 2
    errors = [line for line in capsys.readouterr().err.splitlines() if line.startswith("Error")]
    assert len(errors) == 1
    assert words in errors[0]


def test_a_pickle_with_code_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mark, data = tmp_path / "executed", tmp_path / "evil.pkl"
    data.write_bytes(b"cposix\nsystem\n(Vtouch " + str(mark).encode() + b"\ntR.")
    out = tmp_path / "out.json"
    assert main(["tapvid", str(data), "--predictions", str(tmp_path), "--json", str(out)]) == 2
    assert "posix.system" in capsys.readouterr().err
    assert not mark.exists()
    assert not out.exists()


def test_bad_predictions_leave_the_former_json(
    dataset: Path, write_predictions: WritePredictions, tmp_path: Path
) -> None:
    out = tmp_path / "out.json"
    out.write_text("former")
    folder = write_predictions("left", tracks=np.full((4, 11, 2), math.nan))
    assert main(["tapvid", str(dataset), "--predictions", str(folder), "--json", str(out)]) == 2
    assert out.read_text() == "former"


def test_help_shows_defaults(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["tapvid", "--help"]) == 0
    assert "[default: strided;" in capsys.readouterr().out


def test_a_baseline_needs_no_files_and_its_name_is_kept(
    dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out.json"
    assert main(["tapvid", str(dataset), "--baseline", "direct", "--videos", "left", "--json", str(out)]) == 0
    written = json.loads(out.read_text())
    assert (written["tracker"], written["resolution"]) == ("direct-dis", "original")
    small = ["--resolution", "256x256"]
    assert main(["tapvid", str(dataset), "--baseline", "direct", *small, "--videos", "left", "--json", str(out)]) == 0
    assert json.loads(out.read_text())["resolution"] == "256x256"
    assert main(["tapvid", str(dataset), "--models", "models", *small]) == 2
    assert "--resolution is for --baseline" in capsys.readouterr().err
    assert main(["tapvid", str(dataset), "--baseline", "direct", "--flow-weights", "w.pth"]) == 2
    assert "dis has no weights" in capsys.readouterr().err


def test_a_baseline_without_its_libraries_says_what_to_install(
    dataset: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "decomotion.config", None)  # as where a library that it imports is not there
    assert main(["tapvid", str(dataset), "--baseline", "chain"]) == 2
    assert "--baseline needs the training extra" in capsys.readouterr().err

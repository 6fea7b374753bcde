"""`decomo-export`, and the whole way from frames to a score."""

from __future__ import annotations

import json
import os
import pickle
from pathlib import Path

import numpy as np
import pytest
import torch

import decomo_eval.cli
import decomo_runtime.cli
from decomo_export import exporter
from decomo_export.cli import main
from decomo_export.errors import ExportError
from decomo_export.parity import Parity
from decomo_runtime import Tracker
from decomotion import checkpoint
from tiny_export import Export, random_queries
from tiny_fit import FRAMES, sliding_square, write_truth


def test_it_says_what_it_wrote_and_the_parity_it_measured(fitted: Export):
    assert fitted.said.startswith(f"exported {fitted.path} (")
    assert "MiB); largest difference from torch: " in fitted.said
    assert " px in tracks, " in fitted.said


def test_it_says_how_good_the_fit_is(fitted: Export):
    quality = checkpoint.load(fitted.run / checkpoint.FILE_NAME).quality
    assert quality is not None
    assert fitted.said.splitlines()[1:] == [quality.summary(), f"{quality.warning()}; fit for longer"]
    assert "the fit is starved: it took 20 steps, which is few" in fitted.said


def test_it_says_what_is_thinned_and_that_a_stopped_fit_was_not_measured(
    networks: Export, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    line = "flow at gaps 1 of 1, 2, 4: budget"
    content = torch.load(networks.run / checkpoint.FILE_NAME, weights_only=True)
    torch.save(content | {"thinned": line}, tmp_path / checkpoint.FILE_NAME)
    proto = networks.proto()
    monkeypatch.setattr(exporter, "trace", lambda graph: proto)
    monkeypatch.setattr(exporter, "compute_on_demand", lambda proto: None)
    assert main([str(tmp_path / "model.onnx"), "--run", str(tmp_path), "--bake", "none"]) == 0
    thinned, stopped = capsys.readouterr().out.splitlines()[1:]
    assert thinned == line
    assert stopped.startswith("how good the fit is was not measured, since it was stopped")


def test_the_licence_of_the_clip_is_kept(
    networks: Export, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    proto = networks.proto()
    monkeypatch.setattr(exporter, "trace", lambda graph: proto)
    monkeypatch.setattr(exporter, "compute_on_demand", lambda proto: None)
    argv = [str(tmp_path / "model.onnx"), "--run", str(networks.run), "--bake", "none"]
    assert main([*argv, "--licence", "CC BY-NC 4.0, © Jo"]) == 0
    origin = Tracker(tmp_path / "model.onnx").card.origin
    assert (origin.licence, origin.steps, origin.budget_steps) == ("CC BY-NC 4.0, © Jo", 1, 9)
    assert Tracker(networks.path).card.origin.licence is None


@pytest.mark.parametrize("licence", ["", "  ", "CC BY\n4.0", "x" * 201])
def test_a_licence_is_a_line(licence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main([str(tmp_path / "model.onnx"), "--run", str(tmp_path), "--licence", licence]) == 2
    assert "Error: the licence must be one line of 1 to 200 characters, got " in capsys.readouterr().err


def test_the_runtime_says_what_torch_says(exported: Export):
    tracker = Tracker(exported.path, threads=1)
    assert (tracker.clip_name, tracker.num_frames, tracker.height, tracker.width) == ("sliding", 8, 28, 40)
    queries = random_queries(20)
    queries[:, 1:] = queries[:, 1:].clip(0, 31)
    xy, occlusion, *_ = exported.ask_torch(queries, np.arange(FRAMES))
    tracks = tracker.track(queries)
    np.testing.assert_allclose(tracks.xy, xy, rtol=0, atol=0.01)
    np.testing.assert_allclose(tracks.occlusion, occlusion, rtol=0, atol=1e-3)
    assert (tracks.occluded == (tracks.occlusion > 0.5)).all()


def test_from_frames_to_a_score(fitted: Export, tiny_clip: Path, tmp_path: Path):
    """`fitted` is the work of `decomo-train` and `decomo-export`; here `decomo-track` and `decomo-eval` go on."""
    out, overlay = tmp_path / "tracks.npz", tmp_path / "overlay.mp4"
    asked = ["--grid", "8@0", "--out", str(out), "--overlay", str(overlay), "--clip", str(tiny_clip)]
    assert decomo_runtime.cli.main([str(fitted.path), *asked]) == 0
    assert overlay.stat().st_size > 0
    with np.load(out) as tracks:
        count = len(tracks["queries"])
        assert count >= 9
        assert tracks["tracks"].shape == (count, FRAMES, 2)
        assert np.isfinite(tracks["tracks"]).all()

    dataset, report = write_truth(sliding_square(), tmp_path / "dataset.pkl"), tmp_path / "report.json"
    asked = ["tapvid", str(dataset), "--models", str(fitted.path.parent), "--json", str(report)]
    assert decomo_eval.cli.main(asked) == 0
    metrics = json.loads(report.read_text())["videos"]["sliding"]
    # twenty steps are no fit, but points are followed roughly: a pixel here is 8 of the raster's 256
    assert metrics["pts_within_16"] > 0.5
    assert 0 < metrics["average_jaccard"] <= 1


def test_the_dataset_is_what_it_should_be(tmp_path: Path):
    """Against the pixels: the colour along a true track does not change."""
    clip = sliding_square()
    record = pickle.loads(write_truth(clip, tmp_path / "dataset.pkl").read_bytes())["sliding"]
    x, y = np.round(record["points"] * (40, 28) - 0.5).astype(int).transpose(2, 0, 1)
    colours = clip.frames[np.arange(FRAMES), y, x]
    assert (colours == colours[:, :1]).all()


@pytest.fixture
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


class TestRefused:
    def refused(self, argv: list[str], capsys: pytest.CaptureFixture[str]) -> str:
        assert main(argv) == 2
        assert list(Path.cwd().rglob("*.onnx")) == []
        assert list(Path.cwd().rglob("*partial*")) == []
        out, err = capsys.readouterr()
        assert out == ""
        return err

    def test_no_run(self, elsewhere: Path, capsys: pytest.CaptureFixture[str]):
        assert "there is no run in" in self.refused(["model.onnx"], capsys)
        assert list(elsewhere.iterdir()) == []

    def test_a_name_that_is_no_model_s(self, elsewhere: Path, networks: Export, capsys: pytest.CaptureFixture[str]):
        """The argument of decomo-train, typed again."""
        clip = elsewhere / "goat.mp4"
        clip.write_bytes(b"a film")
        assert main([str(clip), "--run", str(networks.run)]) == 2
        assert "goat.mp4 must end in .onnx" in capsys.readouterr().err
        with pytest.raises(ExportError, match=r"must end in \.onnx"):
            exporter.export(clip, networks.run)
        assert clip.read_bytes() == b"a film"

    def test_a_folder_that_is_no_run(self, elsewhere: Path, capsys: pytest.CaptureFixture[str]):
        said = self.refused(["model.onnx", "--run", str(elsewhere)], capsys)
        assert "checkpoint.pt does not exist; train first" in said

    def test_a_damaged_run(self, elsewhere: Path, capsys: pytest.CaptureFixture[str]):
        (elsewhere / checkpoint.FILE_NAME).write_bytes(b"half")
        assert "is damaged" in self.refused(["model.onnx", "--run", str(elsewhere)], capsys)

    def test_several_windows_at_once(self, elsewhere: Path):
        (elsewhere / "windows.json").touch()
        with pytest.raises(ExportError, match=r"is of several windows; export one of .*window-000"):
            exporter.export(elsewhere / "model.onnx", elsewhere)

    def test_before_the_first_step(self, elsewhere: Path, networks: Export, capsys: pytest.CaptureFixture[str]):
        content = torch.load(networks.run / checkpoint.FILE_NAME, weights_only=True)
        torch.save(content | {"training": {"step": 0}}, elsewhere / checkpoint.FILE_NAME)
        said = self.refused(["model.onnx", "--run", str(elsewhere)], capsys)
        assert "was stopped before its first step; go on with decomo-train --resume" in said

    def test_a_graph_that_differs(
        self, elsewhere: Path, networks: Export, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
    ):
        proto = networks.proto()
        monkeypatch.setattr(exporter, "trace", lambda graph: proto)
        monkeypatch.setattr(exporter, "compute_on_demand", lambda proto: None)

        def measure(*args: object) -> Parity:
            raise ExportError("the exported graph differs from torch by 3 px; nothing was written")

        monkeypatch.setattr(exporter, "measure", measure)
        assert "differs from torch" in self.refused(["model.onnx", "--run", str(networks.run)], capsys)


def test_without_a_run_it_is_the_most_recent(elsewhere: Path, networks: Export, monkeypatch: pytest.MonkeyPatch):
    for age, name in enumerate(["new", "old"]):
        (elsewhere / "runs" / name).mkdir(parents=True)
        content = networks.run.joinpath(checkpoint.FILE_NAME).read_bytes()
        (elsewhere / "runs" / name / checkpoint.FILE_NAME).write_bytes(content)
        os.utime(elsewhere / "runs" / name / checkpoint.FILE_NAME, (1000 - age, 1000 - age))
    loaded: list[Path] = []
    load = checkpoint.load
    monkeypatch.setattr(checkpoint, "load", lambda path: loaded.append(path) or load(path))
    proto = networks.proto()
    monkeypatch.setattr(exporter, "trace", lambda graph: proto)
    monkeypatch.setattr(exporter, "compute_on_demand", lambda proto: None)
    assert main(["model.onnx", "--bake", "none"]) == 0
    assert loaded == [Path("runs/new/checkpoint.pt")]
    assert (elsewhere / "model.onnx").is_file()

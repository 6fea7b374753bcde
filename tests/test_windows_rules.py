"""The whole way under the rules that Windows has for files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import decomo_eval.sample.cli
import decomo_export.cli
import decomo_runtime.cli
import decomotion.cli
import decomotion.prepare_cli
from decomo_runtime.flow.cli import main as flow
from decomotion import files
from tiny_fit import TINY_CPU, sliding_square, write_frames
from windows_rules import SharingError, open_below, windows_rules

SET_TINY = [part for override in TINY_CPU for part in ("--set", override)]


@pytest.fixture
def frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("DECOMO_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    return write_frames(sliding_square(), tmp_path / "sliding")


def test_the_rules(tmp_path: Path):
    (tmp_path / "file").write_text("content")
    (tmp_path / "other").write_text("content")
    (tmp_path / "folder").mkdir()
    np.save(tmp_path / "folder" / "array.npy", np.zeros(3))
    with windows_rules() as renamed:
        with pytest.raises(PermissionError, match="is there"):
            (tmp_path / "file").rename(tmp_path / "other")
        (tmp_path / "file").replace(tmp_path / "other")
        assert renamed == [str(tmp_path / "other")]
        mapped = np.load(tmp_path / "folder" / "array.npy", mmap_mode="r")
        with pytest.raises(SharingError, match=r"array\.npy"):
            (tmp_path / "folder").rename(tmp_path / "new")
        del mapped
        assert open_below(tmp_path) == []
        (tmp_path / "folder").rename(tmp_path / "new")
        with pytest.raises(OSError, match="incorrect"):
            (tmp_path / "new").rename(tmp_path / "a:b")


@pytest.mark.slow
def test_prepare_fit_resume_export_and_ask(frames: Path, tmp_path: Path):
    with windows_rules() as renamed:
        prepare = [str(frames), *SET_TINY, "--preview", "sheet.png"]
        assert decomotion.prepare_cli.main(prepare) == 0
        assert decomotion.prepare_cli.main([*prepare, "--rebuild-cache"]) == 0
        assert decomotion.cli.main([str(frames), *SET_TINY, "--out", "run", "--steps", "3"]) == 0
        assert decomotion.cli.main([str(frames), *SET_TINY, "--out", "run", "--steps", "5"]) == 0
        for _ in range(2):
            assert decomo_export.cli.main(["model.onnx", "--run", "run"]) == 0
        asked = [
            "model.onnx",
            "--grid",
            "16@0",
            "--out",
            "tracks.npz",
            "--overlay",
            "tracks.mp4",
            "--clip",
            str(frames),
        ]
        assert decomo_runtime.cli.main(asked) == 0
        Path("flow").mkdir()  # an empty folder is taken
        assert flow(["model.onnx", "--from", "0", "--to", "2", "--out", "flow"]) == 0
        assert decomo_eval.sample.cli.main(["sample", "--frames", "4", "--size", "48"]) == 0
        assert decomo_eval.sample.cli.main(["sample", "--frames", "5", "--size", "48", "--force"]) == 0
    assert len(renamed) > 10


class TestPutInPlace:
    def test_waits_for_who_has_it_open(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
        (tmp_path / "old").write_text("old")
        (tmp_path / "new").write_text("new")
        held = [open(tmp_path / "old")]  # noqa: SIM115 - closed while it is waited for
        monkeypatch.setattr(files.time, "sleep", lambda _: held[0].close())
        with windows_rules():
            files.put_in_place(tmp_path / "new", tmp_path / "old")
        assert (tmp_path / "old").read_text() == "new"

    def test_says_what_is_open(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
        waited: list[float] = []
        monkeypatch.setattr(files.time, "sleep", waited.append)
        (tmp_path / "tracks.csv").write_text("old")
        with open(tmp_path / "tracks.csv"), windows_rules():  # noqa: SIM117
            with pytest.raises(OSError, match="open in another program") as caught:
                with files.replacing(tmp_path / "tracks.csv") as temporary:
                    temporary.write_text("new")
        assert caught.value.filename == str(tmp_path / "tracks.csv")
        assert 1 < sum(waited) < 2
        assert [file.name for file in tmp_path.iterdir()] == ["tracks.csv"]
        assert (tmp_path / "tracks.csv").read_text() == "old"

    def test_a_folder_in_place_of_an_empty_one(self, tmp_path: Path):
        (tmp_path / "out").mkdir()
        with windows_rules(), files.new_folder(tmp_path / "out") as folder:
            (folder / "file").touch()
        assert [file.name for file in (tmp_path / "out").iterdir()] == ["file"]

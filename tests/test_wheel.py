"""The built wheel in a fresh venv without torch: it asks and scores there."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import numpy as np
import pytest

from tiny_model import VELOCITY, write_tiny_model

ROOT = Path(__file__).parents[1]
FRAMES, SIZE = 8, 64

pytestmark = pytest.mark.slow


def run(*command: str | Path, cwd: Path, timeout: float = 120) -> subprocess.CompletedProcess[str]:
    """Runs `command` without the caller's PYTHONPATH, so that only what is installed can be imported."""
    environment = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "PYTHONHOME")}
    return subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=timeout)


def succeeds(*command: str | Path, cwd: Path, timeout: float = 120) -> str:
    result = run(*command, cwd=cwd, timeout=timeout)
    assert result.returncode == 0, f"{' '.join(map(str, command))}\n{result.stdout}\n{result.stderr}"
    return result.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built from the sdist, which `python -m build` makes first: so the sdist holds all that it needs."""
    folder = tmp_path_factory.mktemp("dist")
    succeeds(sys.executable, "-m", "build", "--outdir", folder, ROOT, cwd=folder, timeout=300)
    (wheel,) = folder.glob("*.whl")
    return wheel


@pytest.fixture(scope="module")
def bin_folder(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a venv with the wheel and the base dependencies."""
    folder = tmp_path_factory.mktemp("torch_free")
    venv.create(folder, with_pip=True)
    bin_folder = folder / "bin"
    succeeds(bin_folder / "python", "-m", "pip", "install", "--quiet", wheel, cwd=folder, timeout=600)
    return bin_folder


@pytest.fixture(scope="module")
def sample(bin_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with `sample/` as decomo-sample writes it and `models/sample.onnx`."""
    folder = tmp_path_factory.mktemp("work")
    succeeds(bin_folder / "decomo-sample", "sample", "--frames", str(FRAMES), "--size", str(SIZE), cwd=folder)
    write_tiny_model(folder / "models" / "sample.onnx", num_frames=FRAMES, height=SIZE, width=SIZE, clip_name="sample")
    return folder


def test_wheel_holds_packages_configs_and_licence_and_nothing_else(wheel: Path):
    names = zipfile.ZipFile(wheel).namelist()
    tops = {name.split("/")[0] for name in names}
    assert {top for top in tops if not top.endswith(".dist-info")} == {
        "decomotion",
        "decomo_export",
        "decomo_runtime",
        "decomo_eval",
    }
    for package in ("decomotion", "decomo_export", "decomo_runtime", "decomo_eval"):
        assert {f"{package}/__init__.py", f"{package}/py.typed"} <= set(names)
    assert {"decomotion/configs/cpu.yaml", "decomotion/configs/paper.yaml"} <= set(names)
    page = ROOT / "runtime" / "decomo_runtime" / "view" / "page"
    built = {f"decomo_runtime/view/page/{name}" for name in json.loads((page / "build.json").read_text())["files"]}
    assert built <= set(names), "users have no Node: the page travels built"
    assert not [name for name in names if "node_modules" in name]
    assert any(name.endswith(".dist-info/licenses/LICENSE") for name in names)
    in_tree = {
        file.relative_to(root).as_posix()
        for root in (ROOT, ROOT / "export", ROOT / "runtime", ROOT / "eval")
        for package in ("decomotion", "decomo_export", "decomo_runtime", "decomo_eval")
        for file in (root / package).rglob("*.py")
    }
    assert {name for name in names if name.endswith(".py")} == in_tree


@pytest.mark.parametrize("library", ["torch", "torchvision", "timm", "kornia", "onnx", "jinja2", "matplotlib", "yaml"])
def test_libraries_of_extras_are_absent(library: str, bin_folder: Path, tmp_path: Path):
    result = run(bin_folder / "python", "-c", f"import {library}", cwd=tmp_path)
    assert result.returncode == 1
    assert f"No module named '{library}'" in result.stderr


def test_the_base_install_is_small(bin_folder: Path):
    """As `du -sm` counts it: docs/install.md says how much it is; a library that grows gets some room here."""
    size = sum(file.lstat().st_blocks * 512 for file in bin_folder.parent.rglob("*"))
    assert size / 2**20 < 480


def test_info_shows_the_card(bin_folder: Path, sample: Path):
    card = json.loads(succeeds(bin_folder / "decomo-info", "models/sample.onnx", "--json", cwd=sample))
    assert (card["clip_name"], card["num_frames"], card["height"], card["width"]) == ("sample", FRAMES, SIZE, SIZE)
    assert "clip         sample\n" in succeeds(bin_folder / "decomo", "info", "models/sample.onnx", cwd=sample)


def test_query_from_python(bin_folder: Path, sample: Path):
    code = """
import json, decomo_runtime
tracks = decomo_runtime.Tracker("models/sample.onnx").track([(2, 20.0, 30.0), (0, 5.0, 6.0)])
print(json.dumps({"xy": tracks.xy.tolist(), "occluded": tracks.occluded.tolist()}))
"""
    answer = json.loads(succeeds(bin_folder / "python", "-c", code, cwd=sample))
    elapsed = np.arange(FRAMES) - np.array([[2], [0]])
    expected = np.array([[20.0, 30.0], [5.0, 6.0]])[:, None] + elapsed[..., None] * VELOCITY
    np.testing.assert_allclose(answer["xy"], expected, atol=1e-4)  # float32 at tens of pixels
    np.testing.assert_array_equal(answer["occluded"], np.abs(elapsed) / FRAMES > 0.5)


def test_track_writes_tracks_and_overlay(bin_folder: Path, sample: Path):
    arguments = ["--grid", "16@0", "--out", "tracks.npz", "--overlay", "tracks.mp4", "--clip", "sample/clip"]
    printed = succeeds(bin_folder / "decomo-track", "models/sample.onnx", *arguments, cwd=sample)
    assert "tracks.npz" in printed
    assert "tracks.mp4" in printed
    with np.load(sample / "tracks.npz") as tracks:
        count = len(tracks["queries"])
        assert count == 16
        assert tracks["tracks"].shape == (count, FRAMES, 2)
        assert tracks["occluded"].shape == tracks["occlusion"].shape == (count, FRAMES)
    assert (sample / "tracks.mp4").stat().st_size > 0


def test_eval_scores_a_folder_of_models(bin_folder: Path, sample: Path):
    arguments = ["sample/sample.pkl", "--models", "models", "--json", "scores.json"]
    succeeds(bin_folder / "decomo-eval", "tapvid", *arguments, cwd=sample)
    scores = json.loads((sample / "scores.json").read_text())
    assert list(scores["videos"]) == ["sample"]
    assert 0 <= scores["mean"]["average_jaccard"] <= 1


@pytest.mark.parametrize("command", ["decomo-train", "decomo-export", "decomo train"])
def test_training_commands_say_what_to_install(command: str, bin_folder: Path, sample: Path):
    """Their help works; the work itself asks for the extra in one sentence."""
    program, *words = command.split()
    assert succeeds(bin_folder / program, *words, "--help", cwd=sample).startswith(f"Usage: {command} ")
    argument = "new.onnx" if command == "decomo-export" else "sample/clip"
    result = run(bin_folder / program, *words, argument, cwd=sample)
    assert result.returncode == 2
    assert "pip install 'decomotion[train]'" in result.stderr
    assert "Traceback" not in result.stderr

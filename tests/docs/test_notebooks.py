"""The notebooks, run from top to bottom in an empty folder."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import pytest

from docs_pages import ROOT, SOURCES

nbformat = pytest.importorskip("nbformat", reason="needs nbformat: pip install -e '.[dev]'")

NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
SECONDS = 600
"""That a cell may take."""
LARGEST = 100_000
"""Bytes of a notebook: outputs are not kept."""


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    client = pytest.importorskip("nbclient", reason="needs nbclient: pip install -e '.[dev]'")
    pytest.importorskip("ipykernel", reason="needs ipykernel: pip install -e '.[dev]'")
    pytest.importorskip("pandas", reason="needs pandas: pip install -e '.[dev]'")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(SOURCES))
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    monkeypatch.setenv("JUPYTER_PATH", str(_kernel(tmp_path / "jupyter")))
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    work = tmp_path / "work"
    work.mkdir()
    notebook = nbformat.read(path, as_version=4)
    runner = client.NotebookClient(
        notebook, timeout=SECONDS, kernel_name="decomotion-tests", resources={"metadata": {"path": str(work)}}
    )
    runner.execute()


def _kernel(folder: Path) -> Path:
    """A kernel of the Python that runs the tests, whatever Jupyter knows of besides."""
    place = folder / "kernels" / "decomotion-tests"
    place.mkdir(parents=True)
    command = [sys.executable, "-m", "ipykernel_launcher", "-f", "{connection_file}"]
    spec = {"argv": command, "display_name": "tests", "language": "python"}
    (place / "kernel.json").write_text(json.dumps(spec))
    return folder


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_well_formed_and_holds_no_outputs(path: Path):
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    assert path.stat().st_size < LARGEST
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(not cell.outputs and cell.execution_count is None for cell in code)
    assert "%pip install" in code[0].source, "hosted notebooks install first"

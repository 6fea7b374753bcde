"""The exported files in the oldest onnxruntime that the package declares, which pip installs beside ours."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from decomo_runtime import Tracker
from tiny_export import random_queries

ROOT = Path(__file__).parents[2]
NUMPY = "numpy==1.26.*"
"""The newest that onnxruntime 1.18 was built for."""
ASK = """
import sys
import numpy, onnxruntime
from decomo_runtime import Tracker
tracker, queries = Tracker(sys.argv[1], threads=1), numpy.load(sys.argv[2])
tracks, seen = tracker.track(queries), tracker.sample(queries)
numpy.savez(sys.argv[3], xy=tracks.xy, occlusion=tracks.occlusion, rgb=seen.rgb, depth=seen.depth)
print(onnxruntime.__version__)
"""

pytestmark = pytest.mark.slow


def oldest() -> str:
    """The version in pyproject.toml."""
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    (version,) = (found[1] for line in declared if (found := re.fullmatch(r"onnxruntime>=([\d.]+)", line)))
    return version


@pytest.fixture(scope="module")
def packages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with that version."""
    folder = tmp_path_factory.mktemp("oldest")
    install = [sys.executable, "-m", "pip", "install", "--quiet", "--no-input", "--retries", "0", "--target"]
    wanted = ["--only-binary", ":all:", f"onnxruntime=={oldest()}.*", NUMPY]
    done = subprocess.run([*install, str(folder), *wanted], capture_output=True, text=True, timeout=300, check=False)
    if done.returncode:
        pytest.skip(f"pip cannot install {wanted[2]} here: {done.stderr.strip().splitlines()[-1]}")
    return folder


@pytest.mark.parametrize("name", ["fitted", "unbaked", "whole", "networks", "canonical", "quantised"])
def test_it_answers_as_ours_does(name: str, packages: Path, tmp_path: Path, request: pytest.FixtureRequest):
    path = request.getfixturevalue(name).path
    queries = np.clip(random_queries(20), 0, 31)
    np.save(tmp_path / "queries.npy", queries)
    search = os.pathsep.join([str(packages), str(ROOT), str(ROOT / "runtime")])
    asked = [sys.executable, "-c", ASK, str(path), str(tmp_path / "queries.npy"), str(tmp_path / "answer.npz")]
    environment = {**os.environ, "PYTHONPATH": search}
    said = subprocess.run(asked, capture_output=True, text=True, timeout=120, check=True, env=environment)
    assert said.stdout.startswith(oldest())
    tracker = Tracker(path, threads=1)
    tracks, seen = tracker.track(queries), tracker.sample(queries)
    with np.load(tmp_path / "answer.npz") as answer:
        np.testing.assert_allclose(answer["xy"], tracks.xy, rtol=0, atol=0.01)
        for field, expected in (("occlusion", tracks.occlusion), ("rgb", seen.rgb), ("depth", seen.depth)):
            np.testing.assert_allclose(answer[field], expected, rtol=0, atol=1e-3, err_msg=field)

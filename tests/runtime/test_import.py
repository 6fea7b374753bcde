from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import decomo_runtime
from decomotion.errors import InputError

HEAVY = {"torch", "onnx", "onnxruntime", "numpy", "cv2", "av"}


def loaded(code: str, *arguments: str) -> list[str]:
    """Which of the heavy modules `code` loads, in a process of its own."""
    code = f"import sys; {code}; print(*sorted({HEAVY!r} & set(sys.modules)))"
    asked = [sys.executable, "-c", code, *arguments]
    return subprocess.run(asked, capture_output=True, text=True, timeout=60, check=True).stdout.split()


@pytest.mark.parametrize("module", ["decomo_runtime", "decomo_runtime.cli", "decomo_runtime.contract"])
def test_import_loads_nothing_heavy(module: str):
    assert loaded(f"import {module}") == []


def test_tracking_loads_what_it_needs(model_path: Path):
    asked = "from decomo_runtime import Tracker; Tracker(sys.argv[1]).track([(0, 3, 4)])"
    assert loaded(asked, str(model_path)) == ["numpy", "onnxruntime"]


@pytest.mark.parametrize("name", decomo_runtime.__all__)
def test_each_name_is_there(name: str):
    assert getattr(decomo_runtime, name).__name__ == name


@pytest.mark.parametrize("package", ["decomotion", "decomo_export", "decomo_runtime", "decomo_eval"])
def test_public_names_are_listed_though_nothing_is_loaded(package: str):
    """For those who press Tab in a notebook."""
    assert loaded(f"import {package}; assert set({package}.__all__) <= set(dir({package}))") == []


def test_unknown_name():
    with pytest.raises(AttributeError, match="no attribute 'Trakcer'"):
        decomo_runtime.Trakcer  # noqa: B018


def test_errors_are_one_family_and_builtins():
    errors = [getattr(decomo_runtime, name) for name in decomo_runtime.__all__ if name.endswith("Error")]
    assert len(errors) == 12
    for error in errors:
        assert issubclass(error, decomo_runtime.RuntimeInputError)
        assert issubclass(error, InputError)
        assert issubclass(error, ValueError)

"""For all tests: where the optional real data lies, and what needs a GPU."""

from __future__ import annotations

import os
from pathlib import Path

import hypothesis
import pytest

SHARED = Path(os.environ.get("DECOMO_SHARED", Path(__file__).parents[2] / "shared"))

hypothesis.settings.register_profile("shared-machine", deadline=None)  # a busy machine is not a failure
hypothesis.settings.load_profile("shared-machine")


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of real clips and weights; the test is skipped where it is absent."""
    if not (SHARED / "data").is_dir():
        pytest.skip(f"no real data at {SHARED}: set DECOMO_SHARED to the folder that holds it")
    return SHARED


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skips tests marked `gpu` where there is none."""
    if item.get_closest_marker("gpu"):
        import torch

        if not torch.cuda.is_available():
            pytest.skip("needs a CUDA device")

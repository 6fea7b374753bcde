"""For the tests of readers: a place for the file that is read."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that all examples share: one file after the other lies there."""
    return tmp_path_factory.mktemp("fuzz")

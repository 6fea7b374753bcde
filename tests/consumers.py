"""Libraries that read the files of other tools' formats, in tests: those that are installed."""

from __future__ import annotations

import warnings
from types import ModuleType
from typing import Any

import pytest


def consumer(name: str) -> Any:
    """The library, or a skipped test where it is absent. What it warns of while it is loaded is its own."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        module: ModuleType = pytest.importorskip(name, reason=f"{name} reads this format and is not installed")
    return module

"""What commands take: disk, while others write and remove."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from harness.usage import disk_of


def test_a_folder_that_is_removed_meanwhile_does_not_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    for name in ("kept", "gone"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "file").write_bytes(bytes(100_000))
    one = disk_of(tmp_path / "kept")
    assert 100_000 <= one < 120_000
    assert disk_of(tmp_path) == 2 * one
    scandir = os.scandir

    def scan(path: str):
        if Path(path).name == "gone":
            raise FileNotFoundError(path)
        return scandir(path)

    monkeypatch.setattr(os, "scandir", scan)
    assert disk_of(tmp_path) == one

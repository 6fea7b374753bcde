"""The drawings of docs/how-it-works.md."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import diagrams

DOCS = Path(__file__).parents[2] / "docs"


def test_every_drawing_is_made_and_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("sys.argv", ["diagrams.py", str(tmp_path)])
    diagrams.main()
    made = {path.name for path in tmp_path.iterdir()}
    shown = re.findall(r"\(images/([\w-]+\.svg)\)", (DOCS / "how-it-works.md").read_text())
    assert set(shown) == made == {path.name for path in (DOCS / "images").glob("*.svg")}

"""Where the cache lies."""

from __future__ import annotations

from pathlib import Path

import pytest

from decomotion.cache import cache_root


@pytest.mark.parametrize("told", [None, "", "elsewhere"])
def test_it_lies_in_the_home_folder_unless_another_is_named(told: str | None, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(Path, "home", lambda: Path("/home/walker"))
    monkeypatch.delenv("DECOMO_CACHE", raising=False)
    if told is not None:
        monkeypatch.setenv("DECOMO_CACHE", told)
    assert cache_root() == (Path(told) if told else Path("/home/walker/.cache/decomotion"))

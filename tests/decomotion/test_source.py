"""Which code is at work: of a checkout its commit, of an installation what pip noted, else the version alone."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from decomotion import __version__, source


@pytest.fixture(autouse=True)
def forgotten() -> Iterator[None]:
    source.code_version.cache_clear()
    yield
    source.code_version.cache_clear()


def checkout(folder: Path) -> str:
    """A repository of one file; its commit's name."""
    git = ["git", "-C", str(folder), "-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false"]
    (folder / "decomotion").mkdir()
    (folder / "decomotion" / "source.py").write_text("")
    for arguments in (["init", "--quiet"], ["add", "."], ["commit", "--quiet", "--message", "One"]):
        subprocess.run([*git, *arguments], check=True, timeout=60)
    return subprocess.check_output([*git, "rev-parse", "HEAD"], text=True, timeout=60).strip()


def test_a_checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    commit = checkout(tmp_path)
    monkeypatch.setattr(source, "__file__", str(tmp_path / "decomotion" / "source.py"))
    assert source.code_version() == f"{__version__}+g{commit[:12]}"
    source.code_version.cache_clear()
    (tmp_path / "new.txt").write_text("not the commit's")
    assert source.code_version() == f"{__version__}+g{commit[:12]}"
    source.code_version.cache_clear()
    (tmp_path / "decomotion" / "source.py").write_text("changed")
    assert source.code_version() == f"{__version__}+g{commit[:12]}.changed"


@pytest.mark.parametrize(
    ("noted", "expected"),
    [
        ('{"url": "u", "vcs_info": {"vcs": "git", "commit_id": "0123456789abcdef"}}', f"{__version__}+g0123456789ab"),
        ('{"url": "file:///src", "dir_info": {}}', __version__),
        ("[]", __version__),
        ("{", __version__),
        (None, __version__),
    ],
)
def test_an_installation(noted: str | None, expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(source, "__file__", str(tmp_path / "decomotion" / "source.py"))
    monkeypatch.setattr(source, "distribution", lambda _: SimpleNamespace(read_text=lambda _: noted))
    assert source.code_version() == expected


def test_without_git(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    checkout(tmp_path)
    monkeypatch.setattr(source, "__file__", str(tmp_path / "decomotion" / "source.py"))
    monkeypatch.setenv("PATH", "")
    monkeypatch.setattr(source, "distribution", lambda _: SimpleNamespace(read_text=lambda _: None))
    assert source.code_version() == __version__

"""Which code is at work: its version, and the commit where that is known."""

from __future__ import annotations

import json
import subprocess
from functools import cache
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from decomotion.version import __version__

DIGITS = 12
"""Of a commit's name that are kept."""
GIT_SECONDS = 10.0


@cache
def code_version() -> str:
    """`0.1.0`; of a checkout, and of an installation from one, with the commit: `0.1.0+g0123456789ab`.

    A checkout whose files differ from its commit says so: `0.1.0+g0123456789ab.changed`.
    """
    commit = _of_checkout(Path(__file__).parents[1]) or _of_installation()
    return f"{__version__}+g{commit}" if commit else __version__


def _of_checkout(root: Path) -> str | None:
    if not (root / ".git").exists():
        return None
    try:
        commit = _git(root, "rev-parse", f"--short={DIGITS}", "HEAD")
        changed = _git(root, "status", "--porcelain", "--untracked-files=no")
    except (OSError, subprocess.SubprocessError):  # no git, or it does not trust the folder
        return None
    return f"{commit}.changed" if changed else commit


def _git(root: Path, *arguments: str) -> str:
    command = ["git", "-C", str(root), *arguments]
    return subprocess.check_output(
        command, stdin=subprocess.DEVNULL, stderr=subprocess.DEVNULL, encoding="utf-8", timeout=GIT_SECONDS
    ).strip()


def _of_installation() -> str | None:
    """The commit that pip noted (PEP 610) where it was given a repository."""
    try:
        noted = json.loads(distribution("decomotion").read_text("direct_url.json") or "{}")
        return str(noted["vcs_info"]["commit_id"])[:DIGITS]
    except (PackageNotFoundError, ValueError, KeyError, TypeError):
        return None

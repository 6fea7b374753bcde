"""Where lies what can be made again."""

from __future__ import annotations

import os
from pathlib import Path


def cache_root() -> Path:
    """`$DECOMO_CACHE`, or `~/.cache/decomotion`: a folder for each clip, and `videos`."""
    return Path(os.environ.get("DECOMO_CACHE") or Path.home() / ".cache" / "decomotion")

"""Where lies what can be made again."""

from __future__ import annotations

import os
from pathlib import Path

from decomotion.presets import AUTO

KEEP, DROP = "keep", "drop"
PREPARED = (AUTO, KEEP, DROP)
"""What becomes of the prepared supervision when a fit is finished: `decomotion.options.prepared_option`."""
FEW = 4
"""So many clips, or windows of one, are kept by `auto`."""


def cache_root() -> Path:
    """`$DECOMO_CACHE`, or `~/.cache/decomotion`: a folder for each clip, and `videos`."""
    return Path(os.environ.get("DECOMO_CACHE") or Path.home() / ".cache" / "decomotion")


def of_each(prepared: str, count: int) -> str:
    """What `prepared` means for each of so many clips, or windows of one: no longer `auto` where they are many."""
    return DROP if prepared == AUTO and count > FEW else prepared

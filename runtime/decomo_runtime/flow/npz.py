"""Dense correspondence as numpy's arrays."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from decomo_runtime.flow.found import Found


def write(found: Found, path: Path) -> None:
    """`flow` float32 [H, W, 2] (x, y), `occluded` bool, `occlusion` and `error` float32 [H, W], `from`, `to` int64."""
    arrays: dict[str, Any] = {
        "flow": found.dense.flow,
        "occluded": found.dense.occluded,
        "occlusion": found.dense.occlusion,
        **({} if found.dense.error is None else {"error": found.dense.error}),
        "from": np.int64(found.origin),
        "to": np.int64(found.target),
    }
    with open(path, "wb") as file:
        np.savez_compressed(file, **arrays)

"""KITTI's flow as 16-bit png: red and green are 64 times the displacement (x, y) in pixels and 32768, blue is 1.

y points down. Pixels that are not valid are 0 in all three, as KITTI's own writer leaves them: here those that are
hidden in the other frame, as in KITTI's `flow_noc`, and those that move farther than 16 bits can say.
"""

from __future__ import annotations

import logging
from pathlib import Path

import cv2
import numpy as np

from decomo_runtime.flow.found import Found

log = logging.getLogger(__name__)

SCALE, ZERO = 64.0, 32768.0
FARTHEST = 512
"""Pixels, along either axis."""


def write(found: Found, path: Path) -> None:
    """Writes `path`; warns where pixels that are in sight move too far."""
    coded = np.rint(found.dense.flow * SCALE + ZERO)
    held = ((coded >= 0) & (coded <= np.iinfo(np.uint16).max)).all(-1)
    valid = held & ~found.dense.occluded
    lost = int((~held & ~found.dense.occluded).sum())
    if lost:
        log.warning(
            "%d pixels of frame %d move %d pixels or more to frame %d, which KITTI's png cannot say: not valid",
            lost,
            found.origin,
            FARTHEST,
            found.target,
        )
    x, y = np.where(valid[..., None], coded, 0).astype(np.uint16).transpose(2, 0, 1)
    done, encoded = cv2.imencode(".png", np.dstack([valid.astype(np.uint16), y, x]))  # OpenCV's order: blue first
    assert done
    path.write_bytes(encoded.tobytes())

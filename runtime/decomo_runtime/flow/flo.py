"""Middlebury's .flo, and beside it, in the folder `occlusion`, a png that is white where a pixel is hidden.

A tag, width and height as int32, then displacements (x, y) in pixels as float32, row by row; y points down.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from decomo_runtime.flow.found import Found
from decomotion.images import png

TAG = b"PIEH"
"""202021.25 as float32, so that readers see the order of bytes."""


def write(found: Found, path: Path) -> None:
    """Writes `path`, and `occlusion/NAME.png` in its folder."""
    height, width = found.dense.occluded.shape
    path.write_bytes(TAG + struct.pack("<ii", width, height) + found.dense.flow.astype("<f4").tobytes())
    mask = path.parent / "occlusion" / f"{path.stem}.png"
    mask.parent.mkdir(exist_ok=True)
    mask.write_bytes(png(np.where(found.dense.occluded, np.uint8(255), np.uint8(0))))

"""An STMap in OpenEXR: for each pixel of a frame, where to look in the other one.

`R` goes from 0 at the left border to 1 at the right one, `G` from 0 at the bottom to 1 at the top: the centre of the
leftmost of W pixels is at 0.5 / W. `B` is 0; `A` is 1 where the pixel is in sight there and 0 where it is hidden.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from decomo_runtime.flow.exr import write_exr
from decomo_runtime.flow.found import Found


def write(found: Found, path: Path) -> None:
    """Writes `path`."""
    height, width = found.dense.occluded.shape
    row, column = np.indices((height, width))
    x, y = found.dense.flow.transpose(2, 0, 1).astype(np.float64)
    channels = {
        "R": (column + x + 0.5) / width,
        "G": 1 - (row + y + 0.5) / height,
        "B": np.zeros((height, width)),
        "A": ~found.dense.occluded,
    }
    write_exr(path, channels, found.pixel_aspect)

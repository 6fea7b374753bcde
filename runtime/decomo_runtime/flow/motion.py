"""Motion vectors in OpenEXR, as Nuke names and reads them: pixels, y up.

`forward.u`, `forward.v` where the other frame is later, `backward.u`, `backward.v` where it is earlier; `A` is 1 where
the pixel is in sight there and 0 where it is hidden.
"""

from __future__ import annotations

from pathlib import Path

from decomo_runtime.flow.exr import write_exr
from decomo_runtime.flow.found import Found


def write(found: Found, path: Path) -> None:
    """Writes `path`."""
    x, y = found.dense.flow.transpose(2, 0, 1)
    layer = "forward" if found.target >= found.origin else "backward"
    channels = {f"{layer}.u": x, f"{layer}.v": -y, "A": ~found.dense.occluded}
    write_exr(path, channels, found.pixel_aspect)

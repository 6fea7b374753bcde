"""OpenEXR, as motion vectors and STMaps are written: float32, each channel named."""

from __future__ import annotations

from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt


def write_exr(
    path: Path,
    channels: Mapping[str, npt.NDArray[Any]],
    pixel_aspect: float,
    notes: Mapping[str, str] | None = None,
) -> None:
    """Writes `channels` [H, W] by name, the first row on top, and `notes` into the header."""
    import OpenEXR

    header = {
        **(notes or {}),
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "pixelAspectRatio": float(pixel_aspect),
    }
    whole = {name: np.ascontiguousarray(values, np.float32) for name, values in channels.items()}
    content = BytesIO()  # whose bytes Python writes: it tells what is wrong with a disk
    OpenEXR.File(header, whole).write(content)
    path.write_bytes(content.getvalue())

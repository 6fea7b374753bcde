"""Positions of links on disk: packed into 16 bits, and unpacked where they are asked for."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

PACKED_FROM, PACKED_TO = -1.0, 2.0
"""Positions are packed between these, in lengths of the frame's longer side; what lies beyond is moved there."""
PACKED_STEPS = 2**16 - 1


class PackedPositions:
    """Positions in pixels, packed into 16 bits; indexed like a float32 array, it unpacks what is asked for.

    The step is 3 sides in 65,535: positions are right to 0.006 pixels of a frame whose longer side is 256.
    """

    def __init__(self, packed: npt.NDArray[np.uint16], longer_side: int) -> None:
        self._packed = packed
        self._longer_side = longer_side

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the array of positions."""
        return self._packed.shape

    def __len__(self) -> int:
        return len(self._packed)

    def __getitem__(self, index: Any) -> npt.NDArray[np.float32]:
        step = np.float32((PACKED_TO - PACKED_FROM) * self._longer_side / PACKED_STEPS)
        return np.asarray(self._packed[index]) * step + np.float32(PACKED_FROM * self._longer_side)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> npt.NDArray:
        return self[...].astype(dtype or np.float32)

    def first_points(self, count: int) -> PackedPositions:
        """The first `count` points of each frame, nothing copied."""
        return PackedPositions(self._packed[..., :count, :], self._longer_side)


Positions = npt.NDArray[np.float32] | PackedPositions


def first_points(targets: Positions, count: int) -> Positions:
    """The first `count` points of each frame, nothing copied."""
    return targets.first_points(count) if isinstance(targets, PackedPositions) else targets[:, :, :count]


def pack(xy: npt.NDArray[np.floating], longer_side: int) -> npt.NDArray[np.uint16]:
    """Positions in pixels of a frame of that longer side as `PackedPositions` holds them."""
    share = (xy / longer_side - PACKED_FROM) / (PACKED_TO - PACKED_FROM)
    return np.round(np.clip(share, 0, 1) * PACKED_STEPS).astype(np.uint16)

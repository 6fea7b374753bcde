"""Rectangles of pixels of a raster that covers the clip's frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class Raster:
    """Some rows and columns of a raster; the raster covers a frame, whatever its size (`docs/conventions.md`)."""

    size: tuple[int, int]
    """(height, width) of the whole raster."""
    rows: slice
    columns: slice

    @property
    def part(self) -> tuple[slice, slice]:
        """Index of the rectangle in an array [height, width, ...]."""
        return self.rows, self.columns

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width) of the rectangle."""
        return self.rows.stop - self.rows.start, self.columns.stop - self.columns.start

    def grown(self, margin: int) -> Raster:
        """With so many pixels more on each side, as far as there are any."""
        rows, columns = (
            slice(max(0, part.start - margin), min(length, part.stop + margin))
            for part, length in zip(self.part, self.size, strict=True)
        )
        return Raster(self.size, rows, columns)

    def scaled(self, size: tuple[int, int]) -> Raster:
        """The least rectangle of a raster of another size that holds it."""
        rows, columns = (
            slice(part.start * new // old, -(-part.stop * new // old))
            for part, old, new in zip(self.part, self.size, size, strict=True)
        )
        return Raster(size, rows, columns)


def whole(size: tuple[int, int]) -> Raster:
    """All of a (height, width) raster."""
    return Raster(size, slice(0, size[0]), slice(0, size[1]))


def around(mask: npt.NDArray[np.bool_]) -> Raster | None:
    """The least rectangle that holds what is True in [H, W]; None where nothing is."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return None
    return Raster(mask.shape, slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1))

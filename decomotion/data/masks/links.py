"""Links of a clip's grid points, in units, and values of other frames read along them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from decomotion.data.positions import Positions, first_points
from decomotion.data.sampling import bilinear
from decomotion.units import to_units

Floats = npt.NDArray[np.float32]


class Links:
    """Where the points of one frame lie in another, and what is known there.

    Args:
        points: [frame, point, 2], pixels of the clip, of which the first form a jittered grid; others are not read.
        targets: [frame, frame, point, 2], pixels of the clip, as in the pool.
        confidence: [frame, frame, point], as in the pool; 0 says nothing.
        grid: rows and columns.
        sides: height and width of the clip.
    """

    def __init__(
        self,
        points: Floats,
        targets: Positions,
        confidence: npt.NDArray[np.uint8],
        grid: tuple[int, int],
        sides: tuple[int, int],
    ) -> None:
        self.grid, self._sides = grid, sides
        count = grid[0] * grid[1]
        self.points: Floats = to_units(points[:, :count], *sides)
        """[frame, point, 2], in units."""
        self._targets, self._confidence = first_points(targets, count), confidence[:, :, :count]
        self._cells = np.array([grid[1] / sides[1], grid[0] / sides[0]], np.float32)

    def __len__(self) -> int:
        """Frames."""
        return len(self.points)

    def target(self, frame: int, other: int) -> Floats:
        """Where the points of `frame` lie in `other`, [point, 2], in units."""
        return to_units(self._targets[frame, other], *self._sides)

    def weight(self, frame: int, other: int) -> Floats:
        """Confidence of these links, [point], 0 to 1."""
        return self._confidence[frame, other] / np.float32(255)

    def read(self, values: Floats, frame: int, other: int) -> Floats:
        """`values` [point] or [point, c] of frame `other` where the points of `frame` lie in it, in the same shape."""
        where = (self._targets[frame, other] + 0.5) * self._cells - 0.5
        image = np.ascontiguousarray(values.reshape(*self.grid, -1), np.float32)
        return bilinear(image, where).reshape(values.shape)

"""The pool: correspondences from points of every frame to every other frame, with confidence, on disk.

Each array is a `.npy` file in the folder of the stage that made it, memory-mapped when read (`docs/formats-model.md`):
    points      float32 [T, P, 2]       where the points are, pixels of the clip: a jittered grid of rows x columns,
                                        then those of the user's tracks
    targets     uint16  [T, T, P, 2]    targets[i, j, p]: where point p of frame i lies in frame j, packed: see `pack`
    confidence  uint8   [T, T, P]       255: certain; 0: hidden, outside or unknown
    rgb         uint8   [T, P, 3]       the clip's colour there
    feature     float16 [T, P, C]       the dense feature there, of unit norm; C may be 0
    moving      uint8   [T, P]          1 on what moves relative to the static scene, 0 on the scene, 2 unknown
    camera      float32 [T, 2, 3]       affine map to the middle frame T // 2, normalised coordinates
    object      float32 [T, 2, 3]       the same for what moves

and those of `decomotion.data.structure.Structure`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from decomotion.data.positions import PackedPositions, Positions
from decomotion.data.structure import Structure

UNKNOWN_MOTION = 2
"""Value of `moving` where there is no motion mask."""


@dataclass(frozen=True)
class Pool:
    """Memory-mapped arrays; see the module's docstring for shapes and units. `targets` reads as float32 pixels."""

    points: npt.NDArray[np.float32]
    targets: Positions
    confidence: npt.NDArray[np.uint8]
    rgb: npt.NDArray[np.uint8]
    feature: npt.NDArray[np.float16]
    moving: npt.NDArray[np.uint8]
    camera: npt.NDArray[np.float32]
    object: npt.NDArray[np.float32]
    longer_side: int
    """Of the clip's frames, in pixels."""
    structure: Structure | None = None
    """Of what stands still; None: not known."""
    thinned: str | None = None
    """What of the links there was no time for, in a line; None: nothing."""

    @property
    def num_frames(self) -> int:
        """T."""
        return self.points.shape[0]

    @property
    def num_points(self) -> int:
        """P, points of each frame."""
        return self.points.shape[1]

    @property
    def feature_size(self) -> int:
        """C."""
        return self.feature.shape[-1]


def open_pool(folders: Iterable[Path], longer_side: int, thinned: str | None = None) -> Pool:
    """Opens the arrays of finished stages without loading them; a later folder's array takes an earlier one's place.

    `longer_side` is that of the clip's frames in pixels, `thinned` what is missing of the links.
    """
    files = {file.stem: file for folder in folders for file in folder.glob("*.npy")}

    def opened(kind: type) -> dict[str, Any]:
        names = [each.name for each in fields(kind) if each.name in files]
        return {name: np.load(files[name], mmap_mode="r") for name in names}

    arrays, of_structure = opened(Pool), opened(Structure)
    targets = PackedPositions(arrays.pop("targets"), longer_side)
    structure = Structure(**of_structure) if of_structure else None
    return Pool(**arrays, targets=targets, longer_side=longer_side, structure=structure, thinned=thinned)


def affordable_points(frames: int, channels: int, mebibytes: int, filtered: bool = False) -> int:
    """Points of each frame with which the pool of a clip, `channels` of features included, takes that much disk.

    What is `filtered` has a second confidence.
    """
    per_target = 2 * 2 + 1 + filtered  # packed position, confidence
    structure = 4 * (3 + 3 * 3 + 1)  # place, covariance, agreement
    per_point = frames * per_target + 2 * 4 + 3 + 1 + structure + 2 * channels
    return int(mebibytes * 2**20 / (frames * per_point))


def grid_shape(height: int, width: int, count: int) -> tuple[int, int]:
    """Rows and columns of a grid of about `count` cells that are nearly square."""
    rows = max(1, round((count * height / width) ** 0.5))
    return rows, max(1, round(count / rows))


def jittered_grid(
    frames: int, height: int, width: int, count: int, random: np.random.Generator
) -> npt.NDArray[np.float32]:
    """[frame, point, 2]: one random position in each cell of a grid over the image, row by row, in pixels."""
    rows, columns = grid_shape(height, width, count)
    cell_y, cell_x = np.mgrid[:rows, :columns].astype(np.float32)
    offset = random.random((frames, rows, columns, 2), dtype=np.float32)
    x = (cell_x + offset[..., 0]) * (width / columns) - 0.5
    y = (cell_y + offset[..., 1]) * (height / rows) - 0.5
    inside = [np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)]
    return np.stack(inside, axis=-1).reshape(frames, -1, 2).astype(np.float32)

"""The stage `filter`: second thoughts about the links, each rule as in OmniMotion, on points instead of fields.

A link leads from `xy`, a point of frame i, to `there` in frame j. What returns from `there` is read off the link of the
nearest point of frame j, shifted to `there`: points lie a few pixels apart. Lengths are in pixels of the clip.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from decomotion.arrays import allocated_memmap
from decomotion.data.links.config import FilterConfig
from decomotion.data.positions import Positions
from decomotion.memory import forget
from decomotion.units import unit

SECOND_LOOK_FROM = 1.5
"""First cycles that miss by more than so many thresholds are of hidden places (OmniMotion's factor)."""
SECOND_LOOK_UNITS = 3.0
"""Threshold of the second look where `cycle` names none: OmniMotion's 3 pixels."""

Xy = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]


def cycle_consistent(xy: Xy, returned: Xy, threshold: float) -> Mask:
    """[point]: whether the way there and back ends less than `threshold` from where it began."""
    return np.asarray(np.linalg.norm(returned - xy, axis=-1) < threshold)


def appearance_consistent(here: npt.NDArray[np.floating], there: npt.NDArray[np.floating], threshold: float) -> Mask:
    """[point]: whether the features at both ends, [point, channel] of unit norm, are more similar than `threshold`."""
    return np.asarray(np.einsum("pc,pc->p", here, there, dtype=np.float32) > threshold)


def confirmed_by_second_look(xy: Xy, there: Xy, returned: Xy, there_again: Xy, threshold: float) -> Mask:
    """[point]: hidden places that neighbouring flow agrees about.

    The way there and back misses, because something else is seen `there`; but from where it ends, the way leads to
    the same place `there_again`: the flow that carried the hidden point is consistent with what covers it.
    """
    hidden = np.asarray(np.linalg.norm(returned - xy, axis=-1) > SECOND_LOOK_FROM * threshold)
    return hidden & np.asarray(np.linalg.norm(there_again - there, axis=-1) < threshold)


@dataclass(frozen=True)
class Grid:
    """Finds the nearest of a frame's jittered points by the cell in which a place lies."""

    rows: int
    columns: int
    height: int
    width: int

    def nearest(self, xy: Xy) -> npt.NDArray[np.int64]:
        """Index of the point whose cell holds `xy` [point, 2], or the cell nearest to it."""
        column = np.floor((xy[:, 0] + 0.5) * (self.columns / self.width)).astype(np.int64)
        row = np.floor((xy[:, 1] + 0.5) * (self.rows / self.height)).astype(np.int64)
        return np.clip(row, 0, self.rows - 1) * self.columns + np.clip(column, 0, self.columns - 1)

    def inside(self, xy: Xy) -> Mask:
        """Whether places lie in the image."""
        return np.asarray(((xy >= -0.5) & (xy <= np.array([self.width, self.height]) - 0.5)).all(axis=-1))


def follow(xy: Xy, points: Xy, targets: Xy, nearest: npt.NDArray[np.int64]) -> Xy:
    """Where the links of the `nearest` of `points` lead from `xy`, as shifts: all [point, 2]."""
    return (targets[nearest] + (xy - points[nearest])).astype(np.float32)


def filtered(
    pair: tuple[int, int],
    points: npt.NDArray[np.float32],
    targets: Positions,
    confidence: npt.NDArray[np.uint8],
    feature: npt.NDArray[np.float16],
    grid: Grid,
    config: FilterConfig,
) -> npt.NDArray[np.uint8]:
    """The confidence [point] of the links of one pair (i, j), i not j, after all rules that `config` switches on.

    `targets` may have more points than the others, which are the first.
    """
    i, j = pair
    xy, there, length = points[i], targets[i, j][: points.shape[1]], unit(grid.height, grid.width)
    result = np.array(confidence[i, j])
    landed = grid.nearest(there)
    returned = follow(there, points[j], targets[j, i], landed)
    if config.second_look is not None and abs(i - j) <= config.second_look_gap:
        threshold = length * (config.cycle or SECOND_LOOK_UNITS)
        again = follow(returned, points[i], there, grid.nearest(returned))
        confirmed = confirmed_by_second_look(xy, there, returned, again, threshold) & grid.inside(there)
    else:
        confirmed = np.zeros(len(xy), np.bool_)
    if config.cycle is not None:
        result[~cycle_consistent(xy, returned, config.cycle * length)] = 0
    if config.appearance is not None and abs(i - j) >= config.appearance_gap:
        result[~appearance_consistent(feature[i], feature[j, landed], config.appearance)] = 0
    if config.second_look is not None:
        result[confirmed & (result == 0)] = round(255 * config.second_look)
    return result


def build_filtered(
    points: npt.NDArray[np.float32],
    targets: Positions,
    confidence: npt.NDArray[np.uint8],
    feature: npt.NDArray[np.float16],
    grid: Grid,
    config: FilterConfig,
    progress: bool,
    folder: Path,
) -> dict[str, Any]:
    """Fills the stage's folder with another `confidence`; links of the user's tracks, after the grid's, are kept."""
    frames, on_grid = len(points), grid.rows * grid.columns
    kept = allocated_memmap(folder / "confidence.npy", np.uint8, confidence.shape)
    for i in tqdm(range(frames), "filter", disable=not progress, leave=False):
        kept[i] = confidence[i]
        for j in range(frames):
            if j != i:
                of_grid = (points[:, :on_grid], targets, confidence[..., :on_grid], feature[:, :on_grid])
                kept[i, j, :on_grid] = filtered((i, j), *of_grid, grid, config)
        forget(kept)
        forget(confidence)
    kept.flush()
    return {"kept": float(np.mean([(kept[frame] > 0).mean() for frame in range(frames)]))}

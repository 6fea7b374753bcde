"""The deformation gradient by least squares: the plane nearest to the displacements of the points of a neighbourhood.

It is the mean gradient of the neighbourhood, whose size is the virtual strain gauge's; a smaller one shows finer
detail and more noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

LEAST_SHARE = 0.3
"""Of a gauge's points, to be counted: at a rim the rest belong to something else."""
TORN = 0.1
"""Share of a neighbourhood's side that the residual of one surface stays within: beyond it no plane tells of strain."""
_LEAST_POINTS = 4
_ROUND = 1e-3
"""Least spread of the points along their narrow side over that along their long one."""


@dataclass(frozen=True, eq=False)
class Gradients:
    """Of any shape [...]; nan where too few points are known."""

    deformation: Floats
    """[..., 2, 2], F."""
    residual: Floats
    """[...], root mean square of the points' distances from the plane: noise, and how uneven the strain is."""
    moved: Floats
    """[..., 2], displacement at the middle of all points, by the plane; of a raster, of its nodes."""


def gradients_of_points(reference: Floats, places: Floats, counted: Mask) -> Gradients:
    """One gradient for each of M frames.

    Args:
        reference: [N, 2].
        places: [N, M, 2].
        counted: [N, M], the points that a frame's plane is fitted to.
    """
    weights = counted.astype(np.float64)
    total = np.maximum(weights.sum(0), 1)
    middle = (weights[..., None] * reference[:, None]).sum(0) / total[:, None]
    here = reference[:, None] - middle
    moved = np.where(counted[..., None], places - reference[:, None], 0)
    mean = moved.sum(0) / total[:, None]
    moved = moved - mean
    here = np.where(counted[..., None], here, 0)
    spread = np.einsum("nmi,nmj->mij", here, here)
    product = np.einsum("nmi,nmj->mij", np.where(counted[..., None], moved, 0), here)
    slope = _solved(spread, product, counted.sum(0) >= _LEAST_POINTS)
    left = np.where(counted[..., None], moved - np.einsum("mij,nmj->nmi", slope, here), 0)
    at_middle = mean + np.einsum("mij,mj->mi", slope, reference.mean(0) - middle)
    return Gradients(np.eye(2) + slope, np.sqrt((left**2).sum((0, 2)) / total), at_middle)


def gradients_of_raster(moved: Floats, step: Floats, radius: tuple[int, int], counted: Mask) -> Gradients:
    """A gradient for each node of a raster, over the rectangle of nodes around it.

    Args:
        moved: [h, w, 2], displacements in units of length.
        step: [2], units of length from one node to the next along x and y.
        radius: nodes of the rectangle on either side, along x and y.
        counted: [h, w], nodes that planes are fitted to.
    """
    weights = counted.astype(np.float64)
    values = np.where(counted[..., None], moved, 0).astype(np.float64)
    total = _moment(weights, radius, (0, 0))
    safe = np.maximum(total, 1)
    mean = np.stack([_moment(weights, radius, (1, 0)), _moment(weights, radius, (0, 1))], axis=-1) / safe[..., None]
    spread = np.empty((*weights.shape, 2, 2))
    spread[..., 0, 0] = _moment(weights, radius, (2, 0))
    spread[..., 1, 1] = _moment(weights, radius, (0, 2))
    spread[..., 0, 1] = spread[..., 1, 0] = _moment(weights, radius, (1, 1))
    spread -= safe[..., None, None] * mean[..., :, None] * mean[..., None, :]
    sums = np.stack([_moment(values[..., axis], radius, (0, 0)) for axis in range(2)], axis=-1)
    product = np.empty_like(spread)
    for axis in range(2):
        for along, powers in enumerate(((1, 0), (0, 1))):
            product[..., axis, along] = _moment(values[..., axis], radius, powers) - sums[..., axis] * mean[..., along]
    least = max(_LEAST_POINTS, LEAST_SHARE * (2 * radius[0] + 1) * (2 * radius[1] + 1))
    slope = _solved(spread, product, total >= least)
    squares = _moment((values**2).sum(-1), radius, (0, 0)) - (sums**2).sum(-1) / safe
    explained = (slope * product).sum((-1, -2))
    residual = np.sqrt(np.maximum(squares - explained, 0) / safe)
    return Gradients(np.eye(2) + slope / step, np.where(np.isfinite(explained), residual, np.nan), moved)


def _moment(values: Floats, radius: tuple[int, int], powers: tuple[int, int]) -> Floats:
    """Sums over the rectangle around each node of `values` times powers of the offsets from the node, in nodes."""
    across, down = (
        np.arange(-side, side + 1, dtype=np.float64) ** power for side, power in zip(radius, powers, strict=True)
    )
    return np.asarray(cv2.sepFilter2D(values, cv2.CV_64F, across, down, borderType=cv2.BORDER_CONSTANT), np.float64)


def _solved(spread: Floats, product: Floats, enough: Mask) -> Floats:
    """[..., 2, 2]: `product` by the inverse of `spread`; nan where the points are too few, or lie on a line."""
    determinant = spread[..., 0, 0] * spread[..., 1, 1] - spread[..., 0, 1] ** 2
    trace = spread[..., 0, 0] + spread[..., 1, 1]
    enough = enough & (determinant > _ROUND**2 * trace**2)
    inverse = np.linalg.inv(np.where(enough[..., None, None], spread, np.eye(2)))
    return np.where(enough[..., None, None], product @ inverse, np.nan)

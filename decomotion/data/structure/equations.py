"""Linear equations of points that cameras see, and their weights.

A camera P with rows p1, p2, p3 sees X at (u, v) if (p1 - u p3) X = 0 and (p2 - v p3) X = 0. By how much that fails,
divided by the depth p3 X, is the distance in the picture: least squares whose weights have the former depth in them
come to minimise it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.floating[Any]]

HALF = 128.0
"""Units of one of these coordinates: half of the frame's longer side."""
DEVIATION = 2.0 / HALF
"""A link that misses by so much counts half (Cauchy's weight)."""
NEAREST = 0.2
"""Depths are no less; that of a point at the origin is 1."""
FAR = 6.0
"""Coordinates of points are no larger."""
RIDGE = 1e-5
"""How firmly points are held at the origin, in links: where nothing tells their depth."""

UPPER = np.triu_indices(4)


class Equations:
    """Those of points seen at `seen` [point, frame, 2] by `cameras` [frame, 3, 4].

    Kept are the products of the four numbers of an equation, summed over the two of a link: with them the equations of
    a point are summed by weights, and they make up the squared error.
    """

    def __init__(self, seen: Floats, cameras: Floats) -> None:
        u, v = seen[..., 0], seen[..., 1]
        first = [cameras[:, 0, k] - u * cameras[:, 2, k] for k in range(4)]
        second = [cameras[:, 1, k] - v * cameras[:, 2, k] for k in range(4)]
        self._products = np.stack([first[i] * first[j] + second[i] * second[j] for i, j in zip(*UPPER, strict=True)])
        self._to_depth, self._depth_of_origin = cameras[:, 2, :3].T, cameras[:, 2, 3]

    def missed(self, x: Floats) -> tuple[Floats, Floats]:
        """How far from where points at `x` [point, 3] are seen they should be, [point, frame], and their depths."""
        depth = np.maximum(x @ self._to_depth + self._depth_of_origin, NEAREST)
        one = np.concatenate([x, np.ones((len(x), 1))], axis=1)
        times = np.where(UPPER[0] == UPPER[1], 1, 2)
        squared = np.einsum("knm,nk->nm", self._products, one[:, UPPER[0]] * one[:, UPPER[1]] * times)
        return np.sqrt(squared.clip(min=0)) / depth, depth

    def solved(self, weight: Floats) -> tuple[Floats, Floats]:
        """Points [point, 3] by least squares, weighted by [point, frame], and their normal matrices [point, 3, 3]."""
        sums = np.einsum("knm,nm->nk", self._products, weight)
        whole = np.empty((len(sums), 4, 4))
        whole[:, UPPER[0], UPPER[1]] = whole[:, UPPER[1], UPPER[0]] = sums
        normal = whole[:, :3, :3] + RIDGE * np.eye(3)
        return np.clip(np.linalg.solve(normal, -whole[:, :3, 3:])[..., 0], -FAR, FAR), normal


def weights(counts: Floats, missed: Floats, depth: Floats, deviation: float) -> Floats:
    """Of links that count `counts`, and miss by so much, in the next least squares."""
    return counts / ((1 + (missed / deviation) ** 2) * depth**2)

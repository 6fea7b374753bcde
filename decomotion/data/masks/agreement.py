"""Which pairs of frames call the same things moving.

Between two frames the motion that explains most may be the scene's or that of an object that fills them. What one pair
calls moving then stands to another that shares a frame with it. Pairs are the nodes of a signed graph: the agreement of
two is the mean product of their labels in the frame they share. It falls into two sides, of which one is right.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]
Pair = tuple[int, int]
"""Two frames, the earlier first."""

AGREES = 0.5
"""Share of the best pair's place on its side that a pair has at least."""
VECTORS = 4
"""Iterated at once."""
ITERATIONS = 200


def pair_of(frame: int, other: int) -> Pair:
    """Both, the earlier first."""
    return min(frame, other), max(frame, other)


class Agreement:
    """Collects what pairs say of a frame's points, frame by frame, and divides the pairs."""

    def __init__(self) -> None:
        self._nodes: dict[Pair, int] = {}
        self._frames: list[tuple[int, list[int], npt.NDArray[np.float16], Mask]] = []

    def add(self, frame: int, residuals: Mapping[int, Floats], border: Mask) -> None:
        """Of a frame: residuals [point] by the other frame, NaN where a point is not seen.

        `border` [point] tells the points near the image's border: the scene reaches it, an object rarely all of it.
        """
        nodes = [self._nodes.setdefault(pair_of(frame, other), len(self._nodes)) for other in residuals]
        self._frames.append((frame, nodes, np.stack(list(residuals.values())).astype(np.float16), border))

    def right(self, thresholds: Floats) -> set[Pair]:
        """The pairs that follow the scene; what moves has a residual above its frame's threshold, [frame].

        The sides are the signs of the leading eigenvector of the normalised matrix of agreements, as in spectral
        clustering of signed graphs (Kunegis et al. 2010); pairs between them are small in it.
        """
        grams, votes = [], np.zeros(len(self._nodes))
        for frame, nodes, residuals, border in self._frames:
            labels = spins(residuals.astype(np.float32) / thresholds[frame])
            votes[nodes] += [vote(each, border) for each in labels]
            known = np.nan_to_num(labels)
            grams.append((np.array(nodes), (known @ known.T / known.shape[1]).astype(np.float64)))
        side = sides(grams, len(self._nodes))
        side *= np.sign(side @ votes) or 1
        return {pair for pair, node in self._nodes.items() if side[node] > AGREES * np.abs(side).max()}


def sides(
    grams: Sequence[tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]], count: int
) -> npt.NDArray[np.float64]:
    """Which side of a signed graph each of `count` nodes is on, by sign, and how surely, by magnitude.

    `grams` are its edges: nodes [n] and their agreement [n, n], added up.
    """
    degree = np.full(count, 1e-9)
    for nodes, gram in grams:
        degree[nodes] += np.abs(gram).sum(axis=1)
    scaled = [(nodes, gram / np.sqrt(np.outer(degree[nodes], degree[nodes]))) for nodes, gram in grams]

    def multiplied(vectors: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        product = np.zeros_like(vectors)
        for nodes, gram in scaled:
            product[nodes] += gram @ vectors[nodes]
        return product

    vectors = np.random.default_rng(0).normal(size=(count, min(VECTORS, count)))
    vectors[:, 0] = np.sqrt(degree)  # the answer where all agree
    for _ in range(ITERATIONS):
        vectors = np.linalg.qr(multiplied(vectors) + vectors)[0]  # with the identity no eigenvalue is negative
    turned = np.linalg.eigh(vectors.T @ multiplied(vectors))[1]
    return (vectors @ turned[:, -1]) / np.sqrt(degree)


def spins(ratio: Floats) -> Floats:
    """1 far above 1, -1 far below."""
    squared = ratio**2
    return (squared - 1) / (squared + 1)


def vote(spins: Floats, border: Mask) -> float:
    """How well these labels [point] may be right: the scene reaches the border and is what most of a frame shows."""
    seen = ~np.isnan(spins)
    inner, outer = spins[seen & ~border], spins[seen & border]
    if not len(inner) or not len(outer):
        return 0.0
    return (
        float(ALPHA * -(outer.mean() + inner.mean()) / 2 + inner.mean() - outer.mean()) * len(spins[seen]) / len(spins)
    )


ALPHA = 0.5

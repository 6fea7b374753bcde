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
Doubles = npt.NDArray[np.float64]
Gram = tuple[npt.NDArray[np.int64], Doubles]
"""Nodes [n] and their agreement [n, n]."""
Pair = tuple[int, int]
"""Two frames, the earlier first."""

MAJORITY = 0.125
"""What it weighs that most of a frame stands, beside that what moves is surrounded by it."""
LARGEST = 1e4
"""A residual of more units is taken for so much."""
TIE = 1e-4
"""By which all pairs together agree, so that those which share nothing are on one side."""
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
        values = np.minimum(np.stack(list(residuals.values())), LARGEST).astype(np.float16)
        self._frames.append((frame, nodes, values, border))

    def of_pairs(self, thresholds: Floats) -> dict[Pair, float]:
        """Of each pair: 1 where it follows the scene, -1 where something else, and between where that is not clear.

        What moves has a residual above its frame's threshold, [frame]. The sides are the signs of the leading
        eigenvector of the normalised matrix of agreements, as in spectral clustering of signed graphs (Kunegis et al.
        2010); pairs between them are small in it.
        """
        if not self._nodes:
            return {}
        grams, votes = [], np.zeros(len(self._nodes))
        for frame, nodes, residuals, border in self._frames:
            labels = spins(residuals.astype(np.float32) / thresholds[frame])
            votes[nodes] += np.array([vote(each, border) for each in labels]) / len(labels)  # a frame has one
            known = np.nan_to_num(labels)
            grams.append((np.array(nodes), (known @ known.T / known.shape[1]).astype(np.float64)))
        side = sides(grams, len(self._nodes))
        side /= np.abs(side).max() * (np.sign(side @ votes) or 1)
        return {pair: float(side[node]) for pair, node in self._nodes.items()}


def sides(grams: Sequence[Gram], count: int) -> Doubles:
    """Which side of a signed graph each of `count` nodes is on, by sign, and how surely, by magnitude.

    `grams` are its edges, added up. Parts that no edge joins are on the side on which most of each is.
    """
    degree = np.full(count, 1e-9)
    for nodes, gram in grams:
        degree[nodes] += np.abs(gram).sum(axis=1)
    scaled = [(nodes, gram / np.sqrt(np.outer(degree[nodes], degree[nodes]))) for nodes, gram in grams]

    together = np.sqrt(degree / degree.sum())

    def multiplied(vectors: Doubles) -> Doubles:
        product = TIE * np.outer(together, together @ vectors)
        for nodes, gram in scaled:
            product[nodes] += gram @ vectors[nodes]
        return product

    vectors = np.random.default_rng(0).normal(size=(count, min(VECTORS, count)))
    vectors[:, 0] = together  # the answer where all agree
    for _ in range(ITERATIONS):
        vectors = np.linalg.qr(multiplied(vectors) + vectors)[0]  # with the identity no eigenvalue is negative
    turned = np.linalg.eigh(vectors.T @ multiplied(vectors))[1]
    return (vectors @ turned[:, -1]) / np.sqrt(degree)


def spins(ratio: Floats) -> Floats:
    """1 far above 1, -1 far below."""
    squared = ratio**2
    return (squared - 1) / (squared + 1)


def vote(labels: Floats, border: Mask) -> float:
    """How much `labels` [point] look like those of a scene with something before it, from -1 to 2.

    What moves is rather inside than along the border, and less than what does not.
    """
    seen = ~np.isnan(labels)
    inner, outer = labels[seen & ~border], labels[seen & border]
    if not len(inner) or not len(outer):
        return 0.0
    return float(inner.mean() - outer.mean() - MAJORITY * (inner.mean() + outer.mean()))

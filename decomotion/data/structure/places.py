"""Where points lie, by cameras and each point's own links: those that lead elsewhere than the others count less."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from decomotion.data.structure.equations import DEVIATION, HALF, Equations, Floats, weights
from decomotion.data.timing import least_seconds

OWN = 10.0
"""How many links a point's own place counts."""
NEAR = 4.0
"""Links that many frames away count 1 / e when a point is first placed: they go wrong late, behind what hides it."""
LENIENT, STRICTER = 2.0, 0.8
"""How many times the deviation is allowed at first, and by what that is multiplied in each round."""
ROUNDS = 12
"""Least squares, each weighted by what the former missed."""
NOISE = 0.3 / HALF
"""The least deviation of links, which covariances come from."""
FEWEST_LINKS = 6
"""With fewer there is nothing to agree."""
MOST_FRAMES, BESIDE = 40, 8
"""A point is placed by its links to so many frames at most: all this near, and some of the others."""


def frames_to_place_by(frame: int, frames: int) -> npt.NDArray[np.integer]:
    """The frames by whose links points of `frame` are placed, itself among them."""
    gap = np.abs(np.arange(frames) - frame)
    step = 1 if frames <= MOST_FRAMES else -(-frames // (MOST_FRAMES - 2 * BESIDE))
    return np.flatnonzero((gap <= BESIDE) | (gap % step == 0))


def place(seen: Floats, counts: Floats, cameras: Floats, gap: npt.NDArray[np.integer]) -> tuple[Floats, Floats, Floats]:
    """Places [point, 3], their covariances [point, 3, 3], and agreements [point], of points of one frame.

    Args:
        seen: [point, frame, 2].
        counts: [point, frame], how much that counts.
        cameras: [frame, 3, 4].
        gap: [frame], how many frames from the points' own, which is 0.
    """
    others, gap = np.where(gap == 0, 0.0, counts), np.abs(gap)
    counts = np.where(gap == 0, OWN, counts)
    equations = Equations(seen, cameras)
    weight = counts * np.exp(-gap / NEAR)
    for turn in range(ROUNDS):
        x, _ = equations.solved(weight)
        weight = weights(counts, *equations.missed(x), DEVIATION * max(1.0, LENIENT * STRICTER**turn))
    x, normal = equations.solved(weight)
    missed, _ = equations.missed(x)
    noise = np.sqrt((weight * missed**2).sum(axis=1) / weight.sum(axis=1)).clip(min=NOISE)
    agreeing = others / (1 + (missed / DEVIATION) ** 2)
    agreement = agreeing.sum(axis=1) / others.sum(axis=1).clip(min=1e-6)
    enough = (others > 0).sum(axis=1) >= FEWEST_LINKS
    return x, np.linalg.inv(normal) * noise[:, None, None] ** 2, np.where(enough, agreement, 0)


def seconds_a_frame(points: int, frames: int, random: np.random.Generator) -> float:
    """Wall time in which so many points of a frame are placed on this machine, in a clip of so many frames."""
    by = frames_to_place_by(0, frames)
    seen, cameras = random.uniform(-1, 1, (points, len(by), 2)), np.tile(np.eye(3, 4), (len(by), 1, 1))
    return least_seconds(lambda: place(seen, np.ones(seen.shape[:2]), cameras, by))

"""Cameras of all frames: fitted in turn with the places of a sample of points, each by linear least squares.

The deviation that is allowed shrinks from one that lets all links count, and links are let in as their frames are
farther and farther away: they go wrong late, behind what hides a point. Cameras are affine at first, since perspective
follows what is wrong as readily as what is right as long as points are far from their places.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from decomotion.data.structure.equations import DEVIATION, HALF, Equations, Floats, weights

SAMPLE = 3000
"""Points to which cameras are fitted."""
ITERATIONS = 80
FIRST_DEVIATION, SHRINKING = 30.0 / HALF, 0.95
"""The deviation in the first iteration, and by what it is multiplied in each that follows."""
NEAR, GROWING = 4.0, 1.06
"""Links that many frames away count 1 / e in the first iteration; in each that follows that many times farther ones."""
AFFINE = 30
"""Iterations with affine cameras."""
FIRMLY, LOOSELY = 1e6, 1e-6
"""How firmly the third rows of cameras are held at (0, 0, 0, 1), in links: as long as they are affine, and then."""
STEADY = 1e-8
"""How firmly the other rows are held where they were."""
SPREAD = 0.5
"""Standard deviation of the points in each direction, in coordinates that are chosen anew in each iteration."""
FEWEST_LINKS = 6
"""A point with no more is of no use here."""
FEWEST_POINTS = 20
"""Links in a frame from which its camera is fitted; with fewer it stays as it was."""


def fit_cameras(seen: Floats, counts: Floats, gap: npt.NDArray[np.integer], random: np.random.Generator) -> Floats:
    """[frame, 3, 4]; with too few points cameras are shifted by what there is between neighbouring frames.

    Args:
        seen: [point, frame, 2], where points of some frames are seen.
        counts: [point, frame], how much that counts.
        gap: [point, frame], how many frames from the point's own.
        random: draws the first depths.
    """
    use = (counts > 0).sum(axis=1) > FEWEST_LINKS
    seen, counts, gap = seen[use], counts[use], gap[use]
    known = counts > 0
    shift = _shifts(seen, known)
    cameras = np.tile(np.eye(3, 4), (len(shift), 1, 1))
    cameras[:, :2, 3], cameras[:, 2] = shift, (0, 0, 0, 1)
    if len(seen) < FEWEST_POINTS:
        return cameras
    mean = ((seen - shift) * known[..., None]).sum(axis=1) / known.sum(axis=1)[:, None]
    x = np.concatenate([mean, random.normal(scale=SPREAD, size=(len(mean), 1))], axis=1)
    for iteration in range(ITERATIONS):
        deviation = max(DEVIATION, FIRST_DEVIATION * SHRINKING**iteration)
        x, cameras = _centred(x, cameras)
        now = counts * np.exp(-gap / (NEAR * GROWING**iteration))
        weight = weights(now, *Equations(seen, cameras).missed(x), deviation)
        cameras = _fitted(seen, weight, x, cameras, FIRMLY if iteration < AFFINE else LOOSELY)
        equations = Equations(seen, cameras)
        x, _ = equations.solved(weights(now, *equations.missed(x), deviation))
    return cameras


def _shifts(seen: Floats, known: npt.NDArray[np.bool_]) -> Floats:
    """[frame, 2]: medians of the ways from frame to frame, added up."""
    steps = np.zeros(seen.shape[1:])
    for frame in range(1, len(steps)):
        both = known[:, frame] & known[:, frame - 1]
        if both.any():
            steps[frame] = np.median(seen[both, frame] - seen[both, frame - 1], axis=0)
    return steps.cumsum(axis=0)


def _centred(x: Floats, cameras: Floats) -> tuple[Floats, Floats]:
    """The same in coordinates in which points are about the origin and spread alike in all directions."""
    mean = x.mean(axis=0)
    whiten = SPREAD * np.linalg.cholesky(np.linalg.inv(np.cov(x.T) + 1e-9 * np.eye(3)))
    origin = cameras[..., 3] + cameras[..., :3] @ mean
    cameras = np.concatenate([cameras[..., :3] @ np.linalg.inv(whiten).T, origin[..., None]], axis=-1)
    return (x - mean) @ whiten, cameras / cameras[:, 2:, 3:]


def _fitted(seen: Floats, weight: Floats, x: Floats, former: Floats, firmness: float) -> Floats:
    """Cameras by least squares: eleven numbers each, the last three near 0, since the twelfth is 1."""
    frames, ones = len(former), np.concatenate([x, np.ones((len(x), 1))], axis=1)
    products = (ones[:, :, None] * ones[:, None, :]).reshape(len(x), 16)
    by_u, by_v = weight * seen[..., 0], weight * seen[..., 1]
    factors = weight, by_u, by_v, by_u * seen[..., 0] + by_v * seen[..., 1]
    plain, of_u, of_v, of_squares = ((each.T @ products).reshape(frames, 4, 4) for each in factors)
    normal, wanted = np.zeros((frames, 11, 11)), np.zeros((frames, 11))
    normal[:, :4, :4] = normal[:, 4:8, 4:8] = plain
    normal[:, :4, 8:], normal[:, 4:8, 8:], normal[:, 8:, 8:] = -of_u[..., :3], -of_v[..., :3], of_squares[:, :3, :3]
    normal[:, 8:, :4], normal[:, 8:, 4:8] = -of_u[:, :3], -of_v[:, :3]
    wanted[:, :4], wanted[:, 4:8], wanted[:, 8:] = of_u[:, 3], of_v[:, 3], -of_squares[:, 3, :3]
    held = np.array([STEADY] * 8 + [firmness] * 3) * weight.sum(axis=0)[:, None]
    before = np.concatenate([former[:, 0], former[:, 1], np.zeros((frames, 3))], axis=1)
    enough = (weight > 0).sum(axis=0) >= FEWEST_POINTS
    normal = (normal + np.eye(11) * held[:, None])[enough]
    found = np.linalg.solve(normal, (wanted + held * before)[enough][..., None])[..., 0]
    cameras = former.copy()
    cameras[enough, :2], cameras[enough, 2, :3] = found[:, :8].reshape(-1, 2, 4), found[:, 8:]
    return cameras

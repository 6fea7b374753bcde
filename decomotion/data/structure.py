"""Structure from motion: what stands still is one rigid body, and tells where its points are seen while they are hidden.

Points lie at X in projective space, and frame t sees them at x_t = P_t X, where P_t is a 3x4 matrix (Hartley and
Zisserman 2004, chapters 6 and 18). Cameras and points are fitted to links in turn, each by linear least squares: the
algebraic error, divided by the former depth, is the one in the picture, and Cauchy's weights leave out what moves
otherwise (a scale that shrinks keeps them from leaving out too much at first). No lens is assumed and none is found:
what is asked for is where points are seen, not where they are. Where a camera only turns, or stands, depths are not
told, and do not matter.

Coordinates are units (`decomotion.units`) / 128 - 1, so that the longer side is from -1 to 1; X is (X, Y, Z, 1).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from decomotion.data.surroundings import Expected
from decomotion.units import to_units

Floats = npt.NDArray[np.floating]
Indices = npt.NDArray[np.integer]

HALF = 128.0
"""Units of one of these coordinates' unit: half of the frame's longer side."""
DEVIATION = 2.0 / HALF
"""A link that misses by so much counts half."""

SAMPLE = 3000
"""Points to which cameras are fitted."""
ITERATIONS = 80
FIRST_DEVIATION, SHRINKING = 30.0 / HALF, 0.95
"""The deviation of the first iteration, and by what it is multiplied in each."""
AFFINE = 30
"""Iterations in which cameras are far away: perspective comes after."""
PERSPECTIVE = 1e-4
"""How firmly cameras are held far away afterwards, in links."""
SPREAD = 0.5
"""Standard deviation of the points that cameras are fitted to, in each direction."""
FEWEST_POINTS = 20
"""Links in a frame from which its camera is fitted; it stays as it was with fewer."""

ANCHOR = 10.0
"""How many links a point's own place counts."""
NEAR, GROWING = 4.0, 1.3
"""Links count 1 / e of this many frames away when a point is first placed, and more of them in each round."""
ROUNDS = 12
FEWEST_LINKS = 6
"""Links of a point from which it is placed."""
NOISE = 0.3 / HALF
"""The least deviation of links."""
FAR = 6.0
"""Coordinates of points are no larger."""
NEAREST = 0.2
"""Depths are no less."""
RIDGE = 1e-5
ALL_FRAMES, BESIDE = 40, 8
"""A point is placed by its links to so many frames: to all this near, and to some of the others."""


UPPER = np.triu_indices(4)


@dataclass(frozen=True)
class Structure:
    """Cameras, and the places of the pool's points."""

    cameras: Floats
    """[frame, 3, 4]."""
    places: Floats
    """[frame, point, 3]."""
    covariance: Floats
    """[frame, point, 3, 3]."""
    agreement: Floats
    """[frame, point]: share of a point's links that are of this rigid body; 0 where too few are known."""

    def expected(self, frame: Indices, target: Indices, point: Indices) -> Expected:
        """Where points of a frame are seen in a target frame, [pair, point] each: in units."""
        cameras, x = self.cameras[target], self.places[frame, point]
        seen = (cameras[..., :3] @ x[..., None])[..., 0] + cameras[..., 3]
        depth = seen[..., 2:].clip(min=NEAREST)
        at = seen[..., :2] / depth
        slope = (cameras[..., :2, :3] - at[..., None] * cameras[..., 2:, :3]) / depth[..., None]
        spread = ((slope @ self.covariance[frame, point]) * slope).sum(axis=(-1, -2))
        weight = self.agreement[frame, point] / (1 + spread / DEVIATION**2)
        return Expected(torch.from_numpy((at + np.float32(1)) * np.float32(HALF)), torch.from_numpy(weight))


def structure(
    points: Floats,
    targets: Any,
    confidence: npt.NDArray[np.uint8],
    counted: npt.NDArray[np.bool_],
    sides: tuple[int, int],
    random: np.random.Generator,
) -> Structure:
    """Of the points [frame, point, 2] that are `counted` [frame, point]; all are placed by it.

    Args:
        points: pixels of the clip.
        targets: [frame, frame, point, 2], as in the pool.
        confidence: [frame, frame, point], as in the pool.
        counted: which stand still.
        sides: height and width of the clip.
        random: which points cameras are fitted to.
    """
    links = _Links(points, targets, confidence, sides)
    frames = len(points)
    seen, sure = [], []
    for frame, counts in enumerate(counted):
        still = np.flatnonzero(counts)
        chosen = random.choice(still, min(len(still), -(-SAMPLE // frames)), replace=False)
        xy, weight = links.of(frame, chosen, np.arange(frames))
        seen.append(xy)
        sure.append(weight)
    cameras = fit_cameras(np.concatenate(seen), np.concatenate(sure), random)
    placed = [
        _placed(*links.of(frame, slice(None), some), cameras[some], some == frame, np.abs(some - frame))
        for frame, some in enumerate(map(_some_frames, range(frames), [frames] * frames))
    ]
    places, covariance, agreement = (np.stack(each).astype(np.float32) for each in zip(*placed, strict=True))
    return Structure(cameras.astype(np.float32), places, covariance, agreement)


@dataclass(frozen=True)
class _Links:
    points: Floats
    targets: Any
    confidence: npt.NDArray[np.uint8]
    sides: tuple[int, int]

    def of(
        self, frame: int, which: npt.NDArray[np.integer] | slice, others: npt.NDArray[np.integer]
    ) -> tuple[Floats, Floats]:
        """Where points of a frame are seen in others, [point, frame, 2], and how much that counts, [point, frame]."""
        xy = np.stack([self.targets[frame, other][which] for other in others], axis=1).astype(np.float64)
        sure = np.stack([self.confidence[frame, other][which] for other in others], axis=1) / 255.0
        own = others == frame
        xy[:, own], sure[:, own] = self.points[frame][which][:, None], 1.0
        return to_units(xy, *self.sides) / HALF - 1, sure**2


def _some_frames(frame: int, frames: int) -> npt.NDArray[np.integer]:
    every = np.arange(frames)
    if frames <= ALL_FRAMES:
        return every
    near = np.abs(every - frame) <= BESIDE
    step = -(-frames // (ALL_FRAMES - 2 * BESIDE))
    return np.flatnonzero(near | (np.abs(every - frame) % step == 0))


class _Equations:
    """The linear equations of points, of which the weights change: two of a X = b for each link.

    Kept are the products of the four numbers (a, -b) with each other, summed over both: what least squares need, and
    the squared error as well.
    """

    def __init__(self, seen: Floats, cameras: Floats) -> None:
        rows = [
            (cameras[:, 0, k] - u * cameras[:, 2, k], cameras[:, 1, k] - v * cameras[:, 2, k])
            for u, v in [np.moveaxis(seen, -1, 0)]
            for k in range(4)
        ]
        self.products = np.stack(
            [rows[i][0] * rows[j][0] + rows[i][1] * rows[j][1] for i, j in zip(*UPPER, strict=True)]
        )
        self.to_depth, self.depth_of_origin = cameras[:, 2, :3].T, cameras[:, 2, 3]

    def missed(self, x: Floats) -> tuple[Floats, Floats]:
        """By how much points at `x` [point, 3] are seen elsewhere, [point, frame], and their depths."""
        depth = np.maximum(x @ self.to_depth + self.depth_of_origin, NEAREST)
        one = np.concatenate([x, np.ones((len(x), 1))], axis=1)
        twice = np.where(UPPER[0] == UPPER[1], 1, 2)
        squared = np.einsum("knm,nk->nm", self.products, one[:, UPPER[0]] * one[:, UPPER[1]] * twice)
        return np.sqrt(squared.clip(min=0)) / depth, depth

    def solved(self, weight: Floats) -> tuple[Floats, Floats]:
        """Points [point, 3] by weighted least squares, and the normal matrices [point, 3, 3]."""
        sums = np.einsum("knm,nm->nk", self.products, weight)
        whole = np.empty((len(sums), 4, 4))
        whole[:, UPPER[0], UPPER[1]] = whole[:, UPPER[1], UPPER[0]] = sums
        normal = whole[:, :3, :3] + RIDGE * np.eye(3)
        return np.clip(np.linalg.solve(normal, -whole[:, :3, 3:])[..., 0], -FAR, FAR), normal


def _weights(sure: Floats, missed: Floats, depth: Floats, deviation: float) -> Floats:
    return sure / ((1 + (missed / deviation) ** 2) * depth**2)


def fit_cameras(seen: Floats, sure: Floats, random: np.random.Generator) -> Floats:
    """[frame, 3, 4] from points seen at `seen` [point, frame, 2], as surely as `sure` [point, frame] says."""
    use = (sure > 0).sum(axis=1) > FEWEST_LINKS
    seen, sure = seen[use], sure[use]
    count, frames = sure.shape
    shift = np.zeros((frames, 2))
    for frame in range(1, frames):
        both = (sure[:, frame] > 0) & (sure[:, frame - 1] > 0)
        step = np.median(seen[both, frame] - seen[both, frame - 1], axis=0) if both.any() else 0.0
        shift[frame] = shift[frame - 1] + step
    cameras = np.tile(np.eye(3, 4), (frames, 1, 1))
    cameras[:, 2] = 0, 0, 0, 1
    cameras[:, :2, 3] = shift
    if count < FEWEST_POINTS:
        return cameras
    known = (sure > 0)[..., None]
    mean = ((seen - shift) * known).sum(axis=1) / known.sum(axis=1)
    x = np.concatenate([mean, random.normal(scale=SPREAD, size=(count, 1))], axis=1)
    for iteration in range(ITERATIONS):
        deviation = max(DEVIATION, FIRST_DEVIATION * SHRINKING**iteration)
        x, cameras = _centred(x, cameras)
        weight = _weights(sure, *_Equations(seen, cameras).missed(x), deviation)
        cameras = _fitted_cameras(seen, weight, x, cameras, PERSPECTIVE if iteration >= AFFINE else 1e6)
        equations = _Equations(seen, cameras)
        x, _ = equations.solved(_weights(sure, *equations.missed(x), deviation))
    return cameras


def _centred(x: Floats, cameras: Floats) -> tuple[Floats, Floats]:
    """The same in coordinates in which points have mean 0 and spread alike in all directions."""
    mean = x.mean(axis=0)
    whiten = SPREAD * np.linalg.cholesky(np.linalg.inv(np.cov(x.T) + 1e-9 * np.eye(3)))
    back = np.linalg.inv(whiten)
    origin = cameras[..., 3] + cameras[..., :3] @ mean
    cameras = np.concatenate([cameras[..., :3] @ back.T, origin[..., None]], axis=-1)
    return (x - mean) @ whiten, cameras / cameras[:, 2:, 3:]


def _fitted_cameras(seen: Floats, weight: Floats, x: Floats, former: Floats, perspective: float) -> Floats:
    """Cameras by weighted least squares: 11 numbers each, of which the last three are held near 0."""
    frames = len(former)
    ones = np.concatenate([x, np.ones((len(x), 1))], axis=1)
    products = (ones[:, :, None] * ones[:, None, :]).reshape(len(x), 16)
    u, v = weight * seen[..., 0], weight * seen[..., 1]
    squares = u * seen[..., 0] + v * seen[..., 1]
    plain, by_u, by_v, by_squares = ((each.T @ products).reshape(frames, 4, 4) for each in (weight, u, v, squares))
    normal, wanted = np.zeros((frames, 11, 11)), np.zeros((frames, 11))
    normal[:, :4, :4] = normal[:, 4:8, 4:8] = plain
    normal[:, :4, 8:], normal[:, 4:8, 8:] = -by_u[:, :, :3], -by_v[:, :, :3]
    normal[:, 8:, :4], normal[:, 8:, 4:8] = -by_u[:, :3], -by_v[:, :3]
    normal[:, 8:, 8:] = by_squares[:, :3, :3]
    wanted[:, :4], wanted[:, 4:8], wanted[:, 8:] = by_u[:, 3], by_v[:, 3], -by_squares[:, 3, :3]
    total = weight.sum(axis=0)
    held = np.array([1e-8] * 8 + [perspective] * 3) * total[:, None]
    before = np.concatenate([former[:, 0], former[:, 1], np.zeros((frames, 3))], axis=1)
    normal += np.eye(11) * held[:, None]
    fitted = (weight > 0).sum(axis=0) >= FEWEST_POINTS
    found = np.linalg.solve(normal[fitted], (wanted + held * before)[fitted][..., None])[..., 0]
    cameras = former.copy()
    cameras[fitted, :2] = found[:, :8].reshape(-1, 2, 4)
    cameras[fitted, 2, :3] = found[:, 8:]
    return cameras


def _placed(
    seen: Floats, sure: Floats, cameras: Floats, own: npt.NDArray[np.bool_], gap: npt.NDArray[np.integer]
) -> tuple[Floats, Floats, Floats]:
    """Places, covariances and agreements of one frame's points, by links that are near in time first."""
    anchored = np.where(own, ANCHOR, sure)
    equations = _Equations(seen, cameras)
    weight, reach = anchored * np.exp(-gap / NEAR), NEAR
    x, normal = equations.solved(weight)
    for turn in range(ROUNDS):
        missed, depth = equations.missed(x)
        weight = _weights(anchored, missed, depth, DEVIATION * max(1.0, 2 * 0.8**turn))
        reach *= GROWING
        x, normal = equations.solved(weight * np.exp(-gap / reach) if turn < ROUNDS - 2 else weight)
    missed, _ = equations.missed(x)
    noise = np.sqrt((weight * missed**2).sum(axis=1) / weight.sum(axis=1)).clip(min=NOISE)
    links = np.where(own, 0, sure)
    alike = links / (1 + (missed / DEVIATION) ** 2)
    agreement = alike.sum(axis=1) / links.sum(axis=1).clip(min=1e-6)
    enough = (links > 0).sum(axis=1) >= FEWEST_LINKS
    return x, np.linalg.inv(normal) * noise[:, None, None] ** 2, np.where(enough, agreement, 0)

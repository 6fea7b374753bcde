"""Registers small patches of one frame on another: inverse-compositional Lucas-Kanade, coarse to fine.

A patch is a square of grey values around a point, on each level of a pyramid. Its place in a frame is a point and a
2x2 matrix A: what lies at u from the patch's centre lies at xy + A u there. The matrix is given, the point is sought.
As a patch's own gradients are used, they are taken once, however many frames it is sought in (Baker and Matthews,
2004). Light may differ by a gain and a bias, which are solved for at every step.

n points, p = SIDE^2 pixels of a patch, l levels; places are (x, y) in pixels of the frame, offsets in pixels of a
level.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from decomo_runtime.sampling import sampled

Floats = npt.NDArray[np.float32]
Pyramid = Sequence[Floats]
"""Grey values [h, w] from 0 to 255, each level half as large as the one before."""

RADIUS = 7
"""Of a patch, in pixels of its level."""
SIDE = 2 * RADIUS + 1
STEPS = 8
"""At most, on each level."""

_STILL = 0.01
"""A step shorter than so many pixels of a level is the last."""
_LONGEST = 2.0
"""Of a step, in pixels of a level: beyond it the gradients tell nothing."""
_BLUR = 0.7
"""Of the finest level, deviation in pixels: places between pixels are then interpolated well."""

_LINE = np.arange(-RADIUS, RADIUS + 1, dtype=np.float32)
OFFSETS = np.stack(np.meshgrid(_LINE, _LINE), axis=-1).reshape(-1, 2)
"""[p, 2]"""
WINDOW = np.exp(-(OFFSETS**2).sum(1) / (2 * (0.6 * RADIUS) ** 2)).astype(np.float32)
"""[p], weights of a patch's pixels."""
LEAST_SHOWN = 0.5
"""Of a patch, by weight, to be judged: the rest may lie outside of the frame."""


@dataclass(frozen=True, eq=False)
class Patches:
    """What n points look like, on each level."""

    design: Floats
    """[n, l, 4, p]: gradient along x and along y, grey value, and 1: what a frame's grey values are made of."""
    weights: Floats
    """[n, l, p]; 0 outside of the frame."""

    def __getitem__(self, rows: npt.NDArray[np.integer]) -> Patches:
        return Patches(self.design[rows], self.weights[rows])

    def __setitem__(self, rows: npt.NDArray[np.integer], patches: Patches) -> None:
        self.design[rows], self.weights[rows] = patches.design, patches.weights


@dataclass(frozen=True, eq=False)
class Match:
    """Where n patches are found."""

    xy: Floats
    """[n, 2]"""
    unexplained: Floats
    """[n], share of the frame's variance there that is not the patch's with other light: 0 where they are alike."""
    deviation: Floats
    """[n], pixels by which noise like what is left over would move the place, in the patch's worst direction."""


def empty_patches(points: int, levels: int) -> Patches:
    """To be set."""
    shape = points, levels, SIDE**2
    return Patches(np.empty((points, levels, 4, SIDE**2), np.float32), np.empty(shape, np.float32))


def pyramid(grey: npt.NDArray[np.uint8], levels: int) -> list[Floats]:
    """Of a frame's grey values [h, w]."""
    images = [cv2.GaussianBlur(grey.astype(np.float32), (0, 0), _BLUR)]
    while len(images) < levels:
        images.append(cv2.pyrDown(images[-1]))
    return [image.astype(np.float32, copy=False) for image in images]


def cut(images: Pyramid, xy: Floats, matrix: Floats, weights: Floats = WINDOW) -> Patches:
    """The patches at places `xy` [n, 2], under `matrix` [n, 2, 2]; `weights` [n, l, p] or [p] are of their pixels."""
    patches = empty_patches(len(xy), len(images))
    patches.design[:, :, 3] = 1
    ring = np.arange(-RADIUS - 1, RADIUS + 2, dtype=np.float32)
    around = np.stack(np.meshgrid(ring, ring), axis=-1).reshape(-1, 2)
    for level, image in enumerate(images):
        grey, inside = _sampled(image, xy / 2**level, matrix, around)
        grey, inside = (values.reshape(-1, SIDE + 2, SIDE + 2) for values in (grey, inside))
        design = patches.design[:, level]
        design[:, 0] = (grey[:, 1:-1, 2:] - grey[:, 1:-1, :-2]).reshape(-1, SIDE**2) / 2
        design[:, 1] = (grey[:, 2:, 1:-1] - grey[:, :-2, 1:-1]).reshape(-1, SIDE**2) / 2
        design[:, 2] = grey[:, 1:-1, 1:-1].reshape(-1, SIDE**2)
        patches.weights[:, level] = inside[:, 1:-1, 1:-1].reshape(-1, SIDE**2)
    patches.weights[:] *= weights
    return patches


def register(patches: Patches, images: Pyramid, xy: Floats, matrix: Floats, levels: int) -> Match:
    """Seeks the patches in a frame from places `xy` [n, 2] on, on the `levels` finest levels, coarse to fine."""
    xy = xy.astype(np.float32)
    for level in reversed(range(levels)):
        moving = np.arange(len(xy))
        for _ in range(STEPS):
            step = _step(patches, images, level, xy[moving], matrix[moving], moving)
            xy[moving] += 2**level * step
            moving = moving[np.hypot(*step.T) > _STILL]
            if len(moving) == 0:
                break
    return judge(patches, images, xy, matrix)


def _step(
    patches: Patches, images: Pyramid, level: int, xy: Floats, matrix: Floats, rows: npt.NDArray[np.integer]
) -> Floats:
    """[n, 2], in pixels of the level."""
    design = patches.design[rows, level]
    grey, inside = _sampled(images[level], xy / 2**level, matrix, OFFSETS)
    weights = patches.weights[rows, level] * inside
    solution = _solved(design, weights, grey)
    gain = np.maximum(solution[:, 2:3], 0.1)
    offset = solution[:, :2] / gain
    step = -np.einsum("nij,nj->ni", matrix, offset)
    length = np.hypot(*step.T)[:, None]
    return np.where(np.isfinite(length), step * np.minimum(1, _LONGEST / np.maximum(length, 1e-6)), 0)


def judge(patches: Patches, images: Pyramid, xy: Floats, matrix: Floats) -> Match:
    """How well the patches fit at places `xy` [n, 2], on the finest level."""
    design = patches.design[:, 0]
    grey, inside = _sampled(images[0], xy, matrix, OFFSETS)
    weights = patches.weights[:, 0] * inside
    unexplained, gain, noise = _compared(design[:, 2], grey, weights)
    gradient = design[:, :2]
    tensor = (gradient * weights[:, None]) @ gradient.swapaxes(1, 2)
    across = np.hypot((tensor[:, 0, 0] - tensor[:, 1, 1]) / 2, tensor[:, 0, 1])
    total = weights.sum(1)
    noise = noise / np.maximum(gain, 1e-6)  # in the patch's own light
    least = (tensor[:, 0, 0] + tensor[:, 1, 1]) / 2 - across - total * noise**2 / 3  # noise has gradients too
    deviation = noise / np.sqrt(np.maximum(least, 1e-9))
    enough = total > LEAST_SHOWN * WINDOW.sum()
    return Match(xy, np.where(enough, unexplained, 1), np.where(enough, deviation, np.inf))


def _compared(patch: Floats, grey: Floats, weights: Floats) -> tuple[Floats, Floats, Floats]:
    """`grey` [n, p] as `patch` [n, p] with a gain and a bias: the share of its variance that this leaves, 1 where the
    gain is not positive; the gain; the deviation of what is left. Each [n].
    """
    total = np.maximum(weights.sum(1, keepdims=True), 1e-6)
    weights = weights / total
    patch = patch - (weights * patch).sum(1, keepdims=True)
    grey = grey - (weights * grey).sum(1, keepdims=True)
    common = np.maximum((weights * patch * grey).sum(1), 0)
    own, seen = (np.maximum((weights * values**2).sum(1), 1e-6) for values in (patch, grey))
    unexplained = np.maximum(1 - common**2 / (own * seen), 0)
    return unexplained, common / own, np.sqrt(unexplained * seen)


def _solved(design: Floats, weights: Floats, grey: Floats) -> Floats:
    """Least squares of `grey` [n, p] by `design` [n, k, p]: [n, k]."""
    weighted = design * weights[:, None]
    normal = (weighted @ design.swapaxes(1, 2)).astype(np.float64)
    diagonal = range(design.shape[1])
    normal[:, diagonal, diagonal] = (1 + 1e-5) * normal[:, diagonal, diagonal] + 1e-3  # solvable where all is flat
    right = (weighted @ grey[..., None]).astype(np.float64)
    return np.linalg.solve(normal, right)[..., 0].astype(np.float32)


def _sampled(image: Floats, xy: Floats, matrix: Floats, offsets: Floats) -> tuple[Floats, Floats]:
    """Grey values [n, p] at `xy` + `matrix` `offsets`, in pixels of `image`, and whether these lie in it."""
    height, width = image.shape
    places = xy[:, None] + offsets @ matrix.swapaxes(1, 2)
    inside = ((places > -0.5) & (places < np.array([width, height]) - 0.5)).all(axis=-1)
    return sampled(image, places), np.asarray(inside, np.float32)

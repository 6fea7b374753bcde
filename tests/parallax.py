"""Tracks of a static scene that a camera travels past, with what is known of both."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from decomo_runtime import Tracks

HEIGHT, WIDTH, FOCAL = 360, 640, 600.0


@dataclass(frozen=True, eq=False)
class Journey:
    tracks: Tracks
    centres: npt.NDArray[np.float64]
    """[M, 3], the camera's."""
    focal: float = FOCAL


def journey(points: int = 150, frames: int = 12, first: int = 0, movers: int = 0, aspect: float = 1.0) -> Journey:
    """`movers` of the points fly about, each on its own; pixels are `aspect` times as wide as high."""
    random = np.random.default_rng(0)
    scene = random.uniform((-1.5, -1.2, 4.5), (1.5, 1.2, 9), (points, 3))
    along = np.linspace(0, 1, frames)
    centres = np.stack([-1.2 + 2.4 * along, 0.3 * np.sin(3 * along), 0.5 * along], axis=1)
    xy = np.empty((points, frames, 2))
    for column, (angle, centre) in enumerate(zip(-0.4 * (along - 0.5), centres, strict=True)):
        turned = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
        rolled = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        x, y, z = rolled @ turned @ (scene - centre).T
        xy[:, column] = np.stack([x / aspect, y], axis=1) / z[:, None] * FOCAL + ((WIDTH - 1) / 2, (HEIGHT - 1) / 2)
    xy[:movers] = random.uniform(0, (WIDTH - 1, HEIGHT - 1), (movers, frames, 2))
    occluded = ((xy < -0.5) | (xy > (WIDTH - 0.5, HEIGHT - 0.5))).any(axis=-1) | (random.random(xy.shape[:2]) < 0.1)
    column = (~occluded).argmax(axis=1)  # the first in which it is in sight
    queries = np.column_stack([first + column, xy[np.arange(points), column]]).astype(np.float32)
    numbers = first + np.arange(frames)
    size = HEIGHT, WIDTH
    return Journey(
        Tracks(xy.astype(np.float32), occluded, occluded.astype(np.float32), queries, numbers, size), centres
    )

"""What motion masks cost on this machine."""

from __future__ import annotations

import numpy as np

from decomotion.data.masks.auto import moving_probability
from decomotion.data.masks.cameras import NEIGHBOURS
from decomotion.data.pool import grid_shape, jittered_grid
from decomotion.data.timing import least_seconds
from decomotion.frames import AnyFrames
from decomotion.units import unit

FRAMES = 3
"""Of a trial."""
NOISE, ASTRAY = 0.3, 0.2
"""Of the links in a trial: standard deviation in units, and the share that lies anywhere."""


def seconds_a_frame(frames: AnyFrames, points: int, random: np.random.Generator) -> float:
    """Wall time in which masks `auto` of a clip [frame, h, w, 3] are found, a frame, by those of a few frames.

    They come from about `points` links of each frame to each other, which `random` draws.
    """
    piece = frames[:FRAMES]
    count, (height, width) = len(piece), frames.shape[1:3]
    where = jittered_grid(count, height, width, points, random)
    noise = random.normal(0, NOISE * unit(height, width), (count, *where.shape))
    targets = (where[:, None] + noise).astype(np.float32)
    anywhere = random.random(targets.shape[:3]) < ASTRAY
    targets[anywhere] = random.permutation(targets[anywhere])
    certain = np.full(targets.shape[:3], 255, np.uint8)
    grid = grid_shape(height, width, points)
    seconds = least_seconds(lambda: moving_probability(piece, where, targets, certain, grid, (height, width), random))
    return seconds / (count * (count - 1)) * min(2 * NEIGHBOURS, len(frames) - 1)

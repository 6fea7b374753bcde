"""Tracks of a clip of 640x360 at 25 frames a second whose places in every tool can be worked out by hand."""

from __future__ import annotations

import numpy as np

from decomo_runtime import Tracks

WIDTH, HEIGHT, FPS, NUM_FRAMES = 640, 360, 25.0, 5
FIRST_PIXEL, LAST_PIXEL, MIDDLE = (0.0, 0.0), (639.0, 359.0), (319.5, 179.5)
HIDDEN = (100.0, 100.0)
PLACES = {
    "corner": {0: FIRST_PIXEL, 1: LAST_PIXEL, 3: MIDDLE, 4: (10.25, 20.5)},
    "late": {3: (1.0, 2.0), 4: (3.0, 4.5)},
}
"""Of the points that are in sight: the frames in which they are, and where."""


def known_tracks(*, sized: bool = True, timed: bool = True) -> Tracks:
    """The points of `PLACES`, and one that is never in sight."""
    xy = np.full((3, NUM_FRAMES, 2), HIDDEN, np.float32)
    occluded = np.ones((3, NUM_FRAMES), bool)
    for row, places in enumerate(PLACES.values()):
        for frame, place in places.items():
            xy[row, frame] = place
            occluded[row, frame] = False
    queries = np.array([[0, *FIRST_PIXEL], [3, 1, 2], [2, 5, 5]], np.float32)
    times = np.arange(NUM_FRAMES) / FPS if timed else None
    size = (HEIGHT, WIDTH) if sized else None
    return Tracks(xy, occluded, occluded.astype(np.float32), queries, np.arange(NUM_FRAMES), size, times)


def wandering_tracks(points: int = 7, frames: int = 23) -> Tracks:
    """Points anywhere in the same clip and beyond it, hidden at times, from frame 4 on."""
    random = np.random.default_rng(0)
    xy = random.uniform((-0.5, -0.5), (WIDTH - 0.5, HEIGHT - 0.5), (points, frames, 2)).astype(np.float32)
    occluded = random.random((points, frames)) < 0.4
    occluded[:, 11] = False
    queries = np.concatenate([np.full((points, 1), 15, np.float32), xy[:, 11]], axis=1)
    columns = 4 + np.arange(frames)
    return Tracks(xy, occluded, occluded.astype(np.float32), queries, columns, (HEIGHT, WIDTH), columns / FPS)

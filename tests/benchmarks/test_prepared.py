"""Prepared links as a tracker: which point answers for a query, where that leads, and what is hidden."""

from __future__ import annotations

import numpy as np

from decomo_eval.tapvid import Queries, pixels_to_raster
from decomotion.data.pool import Pool
from harness.prepared import follow_links

WIDTH, HEIGHT, FRAMES = 30, 20, 4
POINTS = np.array([[5.0, 6.0], [22.0, 12.0]], np.float32)
"""Of every frame, in pixels."""
VELOCITY = np.array([[1.5, -0.5], [-2.0, 0.25]], np.float32)
"""Of each, in pixels a frame."""


def make_pool() -> Pool:
    """The second point of frame 1 has no link to frame 3."""
    steps = np.arange(FRAMES)[None] - np.arange(FRAMES)[:, None]
    confidence = np.full((FRAMES, FRAMES, 2), 1, np.uint8)
    confidence[1, 3, 1] = 0
    return Pool(
        points=np.repeat(POINTS[None], FRAMES, axis=0),
        targets=(POINTS + steps[..., None, None] * VELOCITY).astype(np.float32),
        confidence=confidence,
        rgb=np.zeros((FRAMES, 2, 3), np.uint8),
        feature=np.zeros((FRAMES, 2, 0), np.float16),
        moving=np.zeros((FRAMES, 2), np.uint8),
        camera=np.zeros((FRAMES, 2, 3), np.float32),
        object=np.zeros((FRAMES, 2, 3), np.float32),
        longer_side=WIDTH,
    )


def test_queries_go_with_the_nearest_point_of_their_frame():
    frames, beside = np.array([1, 2, 1]), np.array([[2.0, -1.0], [0.0, 3.0], [-4.0, 2.5]])
    points = np.array([0, 0, 1])
    asked = pixels_to_raster(POINTS[points] + beside, WIDTH, HEIGHT)
    unknown = np.zeros((3, FRAMES, 2)), np.zeros((3, FRAMES), bool)
    found = follow_links(Queries(np.column_stack([frames, asked[:, ::-1]]), *unknown), make_pool(), WIDTH, HEIGHT)
    steps = np.arange(FRAMES) - frames[:, None]
    there = (POINTS[points] + beside)[:, None] + steps[..., None] * VELOCITY[points][:, None]
    np.testing.assert_allclose(found.tracks, pixels_to_raster(there, WIDTH, HEIGHT), atol=1e-4)
    hidden = np.zeros((3, FRAMES), bool)
    hidden[2, 3] = True
    np.testing.assert_array_equal(found.occluded, hidden)
    assert found.size == (WIDTH, HEIGHT)

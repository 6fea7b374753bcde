"""Flow of what moves alone, on disk."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from decomotion.clip import Clip
from decomotion.data.flow import Flow, Frame
from decomotion.data.links.layer import Layer
from decomotion.data.links.own_flow import OwnFlow

FRAMES, HEIGHT, WIDTH = 5, 24, 40


class Sized:
    """Says that all moves by (gap, frame), and notes what it is asked."""

    concurrent, guided, field_side = True, True, 512

    def __init__(self) -> None:
        self.asked: list[tuple[int, int]] = []

    def __call__(self, first: Frame, second: Frame, pair: tuple[int, int], start: Flow | None = None) -> Flow:
        self.asked.append(pair)
        return np.broadcast_to(np.float32([pair[1] - pair[0], pair[0]]), (*first.shape[:2], 2)).copy()

    def effort(self, gap: int) -> float:
        return 1.0

    def require(self, pairs: list[tuple[int, int]]) -> None:
        """Any."""


def test_both_ways_at_every_gap_and_found_again(tmp_path: Path) -> None:
    masks = np.zeros((FRAMES, HEIGHT, WIDTH), np.bool_)
    masks[:, 10:18, 4:12] = True
    clip, estimator = Clip("clip", np.zeros((FRAMES, HEIGHT, WIDTH, 3), np.uint8), 24.0), Sized()
    own = OwnFlow(clip, estimator, Layer(masks, (WIDTH, HEIGHT)), tmp_path / "own")
    own.compute((1, 2), progress=False)
    couples = [(0, 1), (1, 2), (2, 3), (3, 4), (0, 2), (1, 3), (2, 4)]
    assert sorted(estimator.asked) == sorted([*couples, *(couple[::-1] for couple in couples)])
    np.testing.assert_array_equal(own(3, 1)[10:18, 4:12], np.broadcast_to(np.float32([-2, 3]), (8, 8, 2)))
    assert not own(3, 1)[:4].any()
    (tmp_path / "own" / "2_3.npy").write_bytes(b"half")
    estimator.asked.clear()
    own.compute((1, 2), progress=False)
    assert estimator.asked == [(2, 3), (3, 2)]

"""Flow of what moves alone, on disk."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from decomotion.clip import Clip
from decomotion.data.flow import Flow, Frame
from decomotion.data.links.layer import Layer
from decomotion.data.links.own_flow import OwnFlow, _difference, likelier

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
    assert np.load(tmp_path / "own" / "3_1.npy").shape == (12, 12, 2)  # 16 units around are 2 pixels
    (tmp_path / "own" / "2_3.npy").write_bytes(b"half")
    estimator.asked.clear()
    own.compute((1, 2), progress=False)
    assert estimator.asked == [(2, 3), (3, 2)]


def test_what_is_found_to_move_and_looks_like_the_scene_goes_with_it(tmp_path: Path) -> None:
    """Twelve columns are found, of which eight move; frames are twice as large as the raster."""
    random = np.random.default_rng(0)
    scene, thing = (
        cv2.GaussianBlur(random.uniform(0, 255, (2 * HEIGHT, 2 * WIDTH, 3)), (0, 0), 1.5) * 3 - 250 for _ in range(2)
    )
    frames = np.stack([scene, scene])
    frames[0][:, 16:32], frames[1][:, 24:40] = thing[:, :16], thing[:, :16]
    frames = frames.clip(0, 255).astype(np.uint8)
    moves, stands = np.zeros((2, HEIGHT, WIDTH, 2), np.float32)
    moves[..., 0] = 4
    found = likelier(*frames, moves, stands, stands)
    assert (found[2:-2, 9:15, 0] == 4).mean() > 0.95
    assert (found[2:-2, 24:-6] == 0).mean() > 0.95
    astray = stands.copy()
    astray[:, 30:, 0] = 0.5  # the way back misses the right by more than a unit, which is 40 / 256
    assert (likelier(*frames, moves, stands, astray)[2:-2, 31:36, 0] == 4).all()
    astray /= 10
    assert (likelier(*frames, moves, stands, astray)[2:-2, 31:36] == 0).mean() > 0.95
    masks = np.zeros((2, HEIGHT, WIDTH), np.bool_)
    masks[:, :, 4:24] = True

    class Right(Sized):
        def __call__(self, first: Frame, second: Frame, pair: tuple[int, int], start: Flow | None = None) -> Flow:
            return np.broadcast_to(np.float32([4 * (pair[1] - pair[0]), 0]), (*first.shape[:2], 2)).copy()

    clip = Clip("clip", frames, 24.0)
    own = OwnFlow(clip, Right(), Layer(masks, (WIDTH, HEIGHT)), tmp_path / "own", lambda *_: stands)
    own.compute((1,), progress=False)
    np.testing.assert_array_equal(own(0, 1)[2:-2, 9:15], found[2:-2, 9:15])
    assert (own(0, 1)[2:-2, 19:23] == 0).mean() > 0.9
    assert (own(1, 0)[2:-2, 13:19, 0] == -4).mean() > 0.95
    there = np.zeros_like(stands)
    there[..., 1] = 0.5  # which none but itself returns from
    own = OwnFlow(clip, Right(), own.layer, tmp_path / "lost", lambda first, _: there if first else stands)
    own.compute((1,), progress=False)
    assert (own(0, 1)[2:-2, 4:24, 0] == 4).all()
    assert not own(0, 1)[:, 24:].any()


def test_colours_are_compared_over_a_window() -> None:
    """On a raster of 320 pixels 3 wide: a pixel that is 9 off in the mean of its channels is 1 in each of nine."""
    here = np.full((120, 320, 3), 100, np.uint8)
    there = here.copy()
    there[61, 202] += np.uint8([9, 18, 0])
    flow = np.broadcast_to(np.float32([2, 1]), (120, 320, 2))
    expected = np.zeros((120, 320))
    expected[59:62, 199:202] = 1
    np.testing.assert_allclose(_difference(here, there, flow), expected, atol=1e-5)


@pytest.mark.parametrize(("side", "own"), [(1, True), (16, False)])
def test_what_a_blur_takes_out_does_not_tell_places_apart(side: int, own: bool) -> None:
    """Chequers of so many pixels of a raster of 960, where colours are blurred by 1.5 pixels.

    Its own flow leads to them inverted, the other to the same a little brighter.
    """
    row, column = np.indices((48, 960))
    black = (row // side + column // side) % 2 == 0
    first = np.where(black, 90, 130)
    second = np.where(column < 640, np.where(black == ((column // 320) % 2 == 0), 90, 130), first + 3)
    frames = [np.repeat(each[..., None], 3, axis=-1).astype(np.uint8) for each in (first, second)]
    flows = [np.broadcast_to(np.float32(flow), (48, 960, 2)) for flow in ((320, 0), (640, 0), (-640, 0))]
    found = likelier(*frames, *flows)[12:36, 100:220]
    assert (found == (320 if own else 640, 0)).all()


def test_where_both_are_as_likely_it_goes_with_all() -> None:
    flat = np.full((48, 80, 3), 77, np.uint8)
    own, there, back = (np.broadcast_to(np.float32(flow), (48, 80, 2)) for flow in ((3, 0), (0, 2), (0, -2)))
    assert (likelier(flat, flat, own, there, back)[5:-5] == (0, 2)).all()
    assert (likelier(flat, flat, own, there, own)[5:-5] == (3, 0)).all()  # the other one does not return


def test_each_frame_s_own_mask_tells_where_it_moves_and_all_else_goes_as_all_does(tmp_path: Path) -> None:
    """Kept in half precision, and of a frame in which nothing moves, nothing."""
    masks = np.zeros((3, HEIGHT, WIDTH), np.bool_)
    masks[0, 8:14, 4:10], masks[1, 8:14, 20:30] = True, True
    noise = np.random.default_rng(0).integers(0, 256, (3, HEIGHT, WIDTH, 3), np.uint8)
    every = np.float32([0.25, 7.5])
    own = OwnFlow(
        Clip("clip", noise, 24.0),
        Sized(),
        Layer(masks, (WIDTH, HEIGHT)),
        tmp_path / "own",
        lambda *_: np.broadcast_to(every, (HEIGHT, WIDTH, 2)).copy(),  # which does not return
    )
    own.compute((1,), progress=False)
    for first, second in ((0, 1), (1, 0)):
        found, moves = own(first, second), masks[first]
        assert (found[moves] == (second - first, first)).all()
        assert (found[~moves] == every).all()
    assert (own(1, 2) == every).all()
    kept = {name: np.load(tmp_path / "own" / f"{name}.npy") for name in ("0_1", "1_2")}
    assert {array.dtype for array in kept.values()} == {np.dtype(np.float16)}
    assert (kept["0_1"].shape, kept["1_2"].size) == ((10, 30, 2), 0)

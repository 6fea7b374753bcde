"""Flow fields at several gaps: what each is started from, and which answer stays."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from decomotion.clip import Clip
from decomotion.data.flow.interface import Flow, Frame
from decomotion.data.links.flow_store import FlowStore, doubtful, nearer, smooth, threads
from decomotion.data.links.matcher import Matches
from decomotion.data.links.matching import MatchStore
from decomotion.data.links.sift_matching import SiftMatcher

FRAMES, SIZE = 7, 32
SPEED = np.array([3.0, -1.0], np.float32)
"""Pixels a frame, of everything."""


def flow(displacement: float | np.ndarray, size: int = SIZE) -> Flow:
    return np.broadcast_to(np.asarray(displacement, np.float32), (size, size, 2)).astype(np.float32)


class Searcher:
    """Finds what moves less than `REACH` pixels from where it starts, and says that the rest stands still."""

    REACH = 4.0
    concurrent, guided, field_side = True, True, 512

    def __init__(self) -> None:
        self.asked: list[tuple[tuple[int, int], float | None]] = []

    def __call__(self, first: Frame, second: Frame, pair: tuple[int, int], start: Flow | None = None) -> Flow:
        begin = None if start is None else start.mean(axis=(0, 1))
        self.asked.append((pair, None if begin is None else float(begin[0])))
        true = SPEED * (pair[1] - pair[0])
        reached = np.linalg.norm(true - (0 if begin is None else begin)) < self.REACH
        return flow(true if reached else SPEED * 0 + (5 if pair[1] > pair[0] else 0))  # not its own way back

    def effort(self, gap: int) -> float:
        return 1.0

    def require(self, pairs: list[tuple[int, int]]) -> None:
        """Any."""


@pytest.fixture
def clip() -> Clip:
    return Clip("still", np.zeros((FRAMES, SIZE, SIZE, 3), np.uint8), 24.0)


def fields(clip: Clip, folder: Path, estimator: Searcher, intervals: tuple[int, ...] = ()) -> FlowStore:
    matches = MatchStore(clip, intervals, SiftMatcher(0), folder / "matches")
    return FlowStore(clip, estimator, matches, folder)


def test_long_gaps_start_at_the_short_ones(clip: Clip, tmp_path: Path) -> None:
    found = fields(clip, tmp_path / "flow", Searcher())
    assert found.compute((1, 2, 5), progress=False) == 2 * (6 + 5 + 2)
    for first, second in [(0, 1), (3, 1), (0, 5), (6, 1)]:
        np.testing.assert_allclose(found(first, second), flow(SPEED * (second - first)), atol=0.01)


def test_long_gaps_are_searched_once_and_neighbours_a_second_time_where_it_may_help(
    clip: Clip, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first search finds what goes from frame 0 to 1, but not from 1 to 2; the matches lead from 2 to 3 where the
    first search did."""
    answers = {(0, 1): SPEED, (1, 0): -SPEED}

    class Some(Searcher):
        def __call__(self, first: Frame, second: Frame, pair: tuple[int, int], start: Flow | None = None) -> Flow:
            self.asked.append((pair, None if start is None else float(start[..., 0].mean())))
            return flow(answers.get(pair, SPEED * 0 + 5))

    estimator = Some()
    found = fields(clip, tmp_path / "flow", estimator, intervals=(1,))
    everywhere = np.ones((SIZE // 4, SIZE // 4), bool)

    def matched(_: MatchStore, first: int, second: int) -> Matches:
        away = flow(5 if {first, second} == {2, 3} else SPEED * (second - first))
        return Matches(away[::4, ::4] / np.float32(4), everywhere)

    monkeypatch.setattr(MatchStore, "__call__", matched)
    found.compute((1, 2), progress=False)
    searches = [pair for pair, _ in estimator.asked]
    assert [searches.count(pair) for pair in ((0, 1), (1, 2), (2, 3))] == [1, 2, 1]
    assert all(searches.count((first, first + 2)) == 1 for first in range(FRAMES - 2))
    assert all(start is not None for (first, second), start in estimator.asked if abs(first - second) == 2)


@pytest.mark.parametrize("way", [0, 1])
@pytest.mark.parametrize(
    ("share", "missed", "away", "expected"),
    [
        (0.1, 0.2, 1.2, True),
        (0.1, 0.05, 1.2, False),  # it returns
        (0.1, 0.2, 0.8, False),  # the start is not elsewhere
        (0.005, 0.2, 1.2, False),  # hardly a pixel
    ],
)
def test_what_is_doubted(way: int, share: float, missed: float, away: float, expected: bool) -> None:
    """Lengths in units, of 0.75 pixels here."""
    height, width = 100, 192
    both = np.zeros((2, height, width, 2), np.float32)
    starts = both.copy()
    rows = slice(0, round(share * 2 * height))
    both[1 - way, rows, : width // 2] = (0, 0.75 * missed)
    starts[way, rows, : width // 2] = (0.75 * away, 0)
    starts[1 - way] = both[1 - way]
    assert doubtful((both[0], both[1]), (starts[0], starts[1])) == expected


def test_without_a_start_what_moves_far_is_lost(clip: Clip, tmp_path: Path) -> None:
    estimator = Searcher()
    estimator.guided = False
    found = fields(clip, tmp_path / "flow", estimator)
    found.compute((1, 2), progress=False)
    np.testing.assert_array_equal(found(0, 2), flow(5))
    assert {start for _, start in estimator.asked} == {None}
    assert len(estimator.asked) == 2 * (6 + 5)


def test_neighbours_start_at_matches(clip: Clip, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    estimator = Searcher()
    estimator.REACH = 2.0
    found = fields(clip, tmp_path / "flow", estimator, intervals=(1,))
    cells = flow(SPEED / 4, SIZE // 4)  # of four pixels
    everywhere = np.ones((SIZE // 4, SIZE // 4), bool)
    monkeypatch.setattr(MatchStore, "__call__", lambda _, first, second: Matches(cells * (second - first), everywhere))
    found.compute((1,), progress=False)
    for first, second in [(0, 1), (4, 3)]:
        np.testing.assert_allclose(found(first, second), flow(SPEED * (second - first)), atol=0.01)


def test_no_more_threads_than_torch_and_the_process_have(monkeypatch: pytest.MonkeyPatch) -> None:
    for cores, of_torch, expected in [({0, 3}, 8, 2), (set(range(8)), 1, 1)]:
        monkeypatch.setattr("os.sched_getaffinity", lambda _, cores=cores: cores, raising=False)
        monkeypatch.setattr(torch, "get_num_threads", lambda of_torch=of_torch: of_torch)
        assert threads() == expected


def test_what_is_there_is_not_made_again(clip: Clip, tmp_path: Path) -> None:
    estimator = Searcher()
    found = fields(clip, tmp_path / "flow", estimator)
    assert found.compute((1,), progress=False, only=slice(1, 3)) == 4
    assert {pair for pair, _ in estimator.asked} == {(1, 2), (2, 1), (2, 3), (3, 2)}
    (tmp_path / "flow" / "2_1.npy").write_bytes(b"half")
    estimator.asked.clear()
    assert found.compute((1,), progress=False) == 12
    assert {pair[0] for pair, _ in estimator.asked if pair[0] < pair[1]} == {0, 1, 3, 4, 5}


def test_what_is_searched_beside_costs_that_much_more(clip: Clip, tmp_path: Path) -> None:
    matches = MatchStore(clip, (), SiftMatcher(0), tmp_path / "matches")
    found = FlowStore(clip, Searcher(), matches, tmp_path / "flow", beside=9 / 64)
    assert found.effort(1) == found.effort(2) == 1 + 9 / 64


def test_the_answer_that_returns_stays_pixel_by_pixel() -> None:
    """On the left the first answer returns, on the right the second; above, both do."""
    ways: list[list[Flow]] = [[flow(0), flow(0)], [flow((4, 0)), flow((-4, 0))]]
    ways[0][1][16:, 16:] = 3
    ways[1][1][16:, :16] = 3
    there, _ = nearer((ways[0][0], ways[0][1]), (ways[1][0], ways[1][1]))
    np.testing.assert_array_equal(there[:16], 0)
    np.testing.assert_array_equal(there[16:, :12], 0)
    np.testing.assert_array_equal(there[17:, 16:], flow((4, 0))[17:, 16:])


def test_matches_go_on_over_cells_that_have_none() -> None:
    trusted = np.random.default_rng(0).random((16, 16)) < 0.3
    displacement = np.where(trusted[..., None], np.float32([2, 1]), 50).astype(np.float32)
    np.testing.assert_allclose(smooth(Matches(displacement, trusted)), flow((2, 1), 16), atol=1e-4)


@pytest.mark.parametrize(("height", "width"), [(40, 96), (96, 40)])
@pytest.mark.parametrize(("gained", "taken"), [(0.0, False), (0.09, False), (0.11, True)])
def test_the_start_has_to_bring_the_way_back_nearer_by_a_tenth_of_a_unit(
    height: int, width: int, gained: float, taken: bool
) -> None:
    """A unit is 0.375 pixels of a raster whose longer side is 96; the first answer misses by 1 pixel."""
    missed = 1 - gained * 0.375
    both, others = (
        (np.full((height, width, 2), (x, 0), np.float32), np.full((height, width, 2), (-x - off, 0), np.float32))
        for x, off in ((2, 1.0), (4, missed))
    )
    chosen = nearer(both, others)
    inside = (slice(0, height), slice(8, width - 8))
    for way in (0, 1):
        np.testing.assert_array_equal(chosen[way][inside], (others if taken else both)[way][inside])


def test_a_start_over_two_frames_is_read_where_the_first_leads(tmp_path: Path) -> None:
    """All goes 3 pixels right and 1 up, then by an eighth of the place it has got to; and back the other way."""
    height, width = 24, 40
    y, x = np.mgrid[:height, :width].astype(np.float32)
    moved = np.broadcast_to(np.array([3, -1], np.float32), (height, width, 2))
    ramp = np.stack([x / 8, -y / 8], axis=-1)
    hops = {(0, 1): moved, (1, 2): ramp, (1, 0): -moved, (2, 1): -ramp}
    starts: dict[tuple[int, int], Flow] = {}

    class Noting(Searcher):
        concurrent = False

        def __call__(self, first: Frame, second: Frame, pair: tuple[int, int], start: Flow | None = None) -> Flow:
            if start is not None:
                starts[pair] = start
            return np.array(hops.get(pair, 0 * moved), np.float32)

    clip = Clip("still", np.zeros((3, height, width, 3), np.uint8), 24.0)
    fields(clip, tmp_path / "flow", Noting()).compute((1, 2), progress=False)
    inside = (slice(4, 20), slice(8, 32))
    # fields are kept in half precision, and read at thirty-seconds of a pixel
    there = np.stack([3 + (x + 3) / 8, -1 - (y - 1) / 8], axis=-1)
    np.testing.assert_allclose(starts[0, 2][inside], there[inside], atol=0.01)
    back = np.stack([-x / 8 - 3, y / 8 + 1], axis=-1)
    np.testing.assert_allclose(starts[2, 0][inside], back[inside], atol=0.01)

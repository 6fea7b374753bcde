"""Matches by appearance: known shifts are found, what is not there is not trusted."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose, assert_array_equal

from decomotion.clip import Clip
from decomotion.data.links import sift_matching
from decomotion.data.links.linking import Rematching, link
from decomotion.data.links.matcher import Matches
from decomotion.data.links.matching import MatchStore
from decomotion.data.links.sift_matching import SiftMatcher, supporters

HEIGHT, WIDTH = 96, 128

Matched = Callable[..., MatchStore]


def textured(seed: int) -> np.ndarray:
    """An image [H, W, 3] with structure at several scales."""
    import cv2

    random = np.random.default_rng(seed)
    scales = [random.integers(0, 255, (HEIGHT // cell, WIDTH // cell, 3), dtype=np.uint8) for cell in (4, 8, 16)]
    return np.mean(
        [cv2.resize(scale, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC) for scale in scales], axis=0
    ).astype(np.uint8)


def clip_of(*frames: np.ndarray) -> Clip:
    return Clip("test", np.stack(frames), 24.0)


@pytest.fixture
def matched(tmp_path: Path) -> Matched:
    def between(*frames: np.ndarray) -> MatchStore:
        store = MatchStore(clip_of(*frames), (1, 2), SiftMatcher(10), tmp_path / "matches")
        store.compute(progress=False)
        return store

    return between


@pytest.mark.parametrize(("down", "right"), [(8, 20), (7, 22), (1, -3)])
def test_a_known_shift_is_found(matched: Matched, down: int, right: int) -> None:
    """In whole cells of 4 pixels, and between them."""
    image = textured(0)
    store = matched(image, np.roll(image, (down, right), axis=(0, 1)))
    forward, backward = store(0, 1), store(1, 0)
    cell = WIDTH / forward.trusted.shape[1]
    assert forward.trusted.mean() > 0.5
    assert_allclose(np.median(forward.displacement[forward.trusted], axis=0) * cell, [right, down], atol=0.3)
    assert_allclose(np.median(backward.displacement[backward.trusted], axis=0) * cell, [-right, -down], atol=0.3)


def test_a_frame_matches_itself_where_it_is(matched: Matched) -> None:
    image = textured(1)
    matches = matched(image, image)(0, 1)
    off = np.abs(matches.displacement[matches.trusted])
    assert off.max() <= 0.51  # a descriptor beside the cell's middle
    assert off.mean() < 0.1


def test_other_content_is_not_trusted(matched: Matched) -> None:
    assert matched(textured(2), textured(3))(0, 1).trusted.mean() < 0.05


def test_gaps_that_a_clip_does_not_have_are_left_out(matched: Matched) -> None:
    assert matched(textured(4), textured(4)).intervals == (1,)


def test_supporters_are_mutual_neighbours_that_moved_likewise() -> None:
    displacement = torch.zeros(5, 5, 2)
    displacement[0, 0] = 10.0
    mutual = torch.ones(5, 5, dtype=torch.bool)
    mutual[4, 4] = False
    count = supporters(displacement, mutual)
    assert count[2, 2] == 24 - 2
    assert count[0, 0] == 0


@pytest.mark.parametrize("step", [1, -1])
def test_a_point_hidden_longer_than_flow_reaches_is_found_again(step: int) -> None:
    """Flow loses everything in every hop; only the match over four frames leads on."""
    points = np.full((5, 1, 2), 8.0, np.float32)

    def lost(source: int, target: int) -> np.ndarray:
        return np.full((16, 16, 2), 3.0 if target > source else 4.0, np.float32)  # forward and back do not agree

    shift = np.full((4, 4, 2), 0.5 * step, np.float32)
    matches = Matches(shift, np.ones((4, 4), bool))
    links = list(link(points, lost, (1,), 1.0, 10, step, Rematching(lambda i, j: matches, (4,))))
    last = links[-1]
    assert not last.occluded[0, 0]
    assert_allclose(last.xy[0, 0], [8 + 2 * step] * 2)
    assert all(each.occluded.all() for each in links[:-1])


def test_a_match_leads_on_from_its_own_cell_and_only_where_flow_does_not() -> None:
    """4 rows of 8 cells over a raster of 16 x 32 pixels; flow is lost in the left half, still in the right."""
    points = np.array([[4.0, 1.0], [9.0, 6.0], [13.0, 14.0], [25.0, 9.0]], np.float32)
    displacement, trusted = np.zeros((4, 8, 2), np.float32), np.ones((4, 8), bool)
    displacement[0, 1] = (2.0, 1.0)  # cells: 8 and 4 pixels
    displacement[1, 2] = (-1.0, 0.5)
    displacement[3, 3] = (0.25, 0.0)
    trusted[3, 3] = False
    displacement[2, 6] = (1.0, 1.0)

    def flow(source: int, target: int) -> np.ndarray:
        field = np.zeros((16, 32, 2), np.float32)
        field[:, :16] = 3.0 if target > source else 4.0  # forward and back do not agree
        return field

    sources = np.stack([points, points])
    matches = Matches(displacement, trusted)
    (links,) = link(sources, flow, (1,), 1.0, 10, 1, Rematching(lambda i, j: matches, (1,)))
    assert links.occluded[0].tolist() == [False, False, True, False]
    assert_allclose(links.xy[0, [0, 1, 3]], [[12.0, 5.0], [5.0, 8.0], [25.0, 9.0]])


def test_a_match_is_refined_where_it_is_taken_and_seen() -> None:
    """Flow leads on from the second point; the third's match is not trusted, and the fourth's leaves the image."""
    points = np.array([[4.0, 1.0], [25.0, 9.0], [13.0, 14.0], [1.0, 9.0]], np.float32)
    displacement, trusted = np.full((4, 8, 2), 0.5, np.float32), np.ones((4, 8), bool)
    trusted[3, 3] = False
    displacement[2, 0] = (-1.0, 0.0)
    asked = []

    def flow(source: int, target: int) -> np.ndarray:
        field = np.zeros((16, 32, 2), np.float32)
        field[:, :16] = 3.0 if target > source else 4.0  # forward and back do not agree
        return field

    def refine(first: int, second: int, xy: np.ndarray, found: np.ndarray, raster: tuple[int, ...]) -> np.ndarray:
        asked.append((first, second, xy.tolist(), raster))
        return found + np.float32(0.25)

    sources = np.stack([points, points])
    matches = Matches(displacement, trusted)
    (links,) = link(sources, flow, (1,), 1.0, 10, 1, Rematching(lambda i, j: matches, (1,), refine))
    assert asked == [(0, 1, [[4.0, 1.0]], (16, 32))]
    assert_allclose(links.xy[0, :2], [[6.25, 3.25], [25.0, 9.0]])


def test_a_point_is_refined_once_where_it_is_found_at_last() -> None:
    """Matches over two frames cost what those over three do; of equals the nearer one stays."""
    points, asked = np.full((4, 1, 2), 8.0, np.float32), []
    matches = Matches(np.zeros((4, 4, 2), np.float32), np.ones((4, 4), bool))

    def lost(source: int, target: int) -> np.ndarray:
        return np.full((16, 16, 2), 3.0 if target > source else 4.0, np.float32)

    def refine(first: int, second: int, xy: np.ndarray, found: np.ndarray, _: tuple[int, ...]) -> np.ndarray:
        if len(xy):
            asked.append((first, second))
        return found + np.float32(0.5)

    *_, last = link(points, lost, (1,), 1.0, 10, 1, Rematching(lambda *_: matches, (2, 3), refine))
    assert last.xy[0, 0].tolist() == [8.5, 8.5]
    assert asked.count((0, 3)) == 1


@pytest.mark.parametrize("block", [5, 256])
def test_the_nearest_of_both_sides(block: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sift_matching, "BLOCK", block)
    cells, others = torch.randn(2, 4, 6, 8, generator=torch.Generator().manual_seed(0))
    others[1, 2] = others[3, 1] = cells[2, 3]
    cells[0, 1] = cells[3, 2] = 10 * others[2, 0]  # of equals the first
    similarity = cells.reshape(24, 8) @ others.reshape(24, 8).T
    of_cells, of_others = sift_matching._nearest(cells, others)
    assert_array_equal(of_cells, similarity.numpy().argmax(1))
    assert_array_equal(of_others, similarity.numpy().argmax(0))


@pytest.mark.parametrize(
    ("intervals", "neighbours", "gaps"), [((2,), True, [1, 2]), ((2,), False, [2]), ((), True, [])]
)
def test_neighbours_are_matched_on_demand_but_not_linked(
    intervals: tuple[int, ...], neighbours: bool, gaps: list[int], tmp_path: Path
) -> None:
    image = textured(5)
    store = MatchStore(clip_of(image, image, image), intervals, SiftMatcher(10), tmp_path, neighbours=neighbours)
    store.compute(progress=False)
    assert (store.intervals, store.gaps) == (intervals, gaps)
    for gap in gaps:
        assert store(0, gap).trusted.any()


def test_what_is_there_is_not_matched_again(matched: Matched, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    images = [textured(6), textured(7), textured(8)]
    store = matched(*images)
    expected = store(2, 1)
    (tmp_path / "matches" / "2_1.npy").write_bytes(b"half")
    asked: list[int] = []
    both_ways = SiftMatcher.both_ways

    def counted(self: SiftMatcher, a: torch.Tensor, b: torch.Tensor) -> tuple[Matches, Matches]:
        asked.append(1)
        return both_ways(self, a, b)

    monkeypatch.setattr(SiftMatcher, "both_ways", counted)
    again = matched(*images)(2, 1)
    assert len(asked) == 1
    assert_array_equal(again.displacement, expected.displacement)
    assert_array_equal(again.trusted, expected.trusted)
    monkeypatch.setattr("decomotion.data.links.sift_matching.describe", None)  # nothing is missing
    matched(*images)


def test_supporters_one_by_one() -> None:
    """Cells up to two rows and columns away whose displacement differs by less than three quarters of a cell."""
    random = np.random.default_rng(0)
    displacement = random.normal(0, 0.5, (6, 9, 2)).astype(np.float32)
    mutual = random.random((6, 9)) < 0.7
    count = supporters(torch.from_numpy(displacement), torch.from_numpy(mutual))
    for row, column in np.ndindex(6, 9):
        expected = 0
        for other_row, other_column in np.ndindex(6, 9):
            near = max(abs(row - other_row), abs(column - other_column)) in (1, 2)
            apart = np.hypot(*(displacement[row, column] - displacement[other_row, other_column]))
            expected += bool(near and mutual[other_row, other_column] and apart < 0.75)
        assert count[row, column] == expected


def test_a_match_is_mutual_if_the_way_back_ends_at_most_one_cell_away() -> None:
    """Six rows of five cells; the cell in row 2, column 2 leads to itself, and back to somewhere near."""
    own = torch.arange(30)
    for row, column, mutual in [(2, 2, True), (3, 3, True), (1, 2, True), (2, 4, False), (4, 2, False), (1, 4, False)]:
        back = own.clone()
        back[12] = 5 * row + column
        assert sift_matching._returns(own, back, width=5)[12] == mutual


@pytest.mark.parametrize("shift", [-0.4, -0.1, 0.0, 0.3, 0.5])
def test_a_parabola_is_read_at_its_top(shift: float) -> None:
    samples = torch.arange(6.0)
    values = (3 - 0.2 * (samples - 2 - shift) ** 2)[None]
    torch.testing.assert_close(sift_matching._peak(values, torch.tensor([2])), torch.tensor([shift]), atol=1e-5, rtol=0)
    for top in (0, 5):  # at the border there is no third sample
        assert sift_matching._peak(values, torch.tensor([top])).item() == 0
    assert sift_matching._peak(torch.ones(1, 6), torch.tensor([2])).item() == 0


def test_descriptors_are_squares_of_a_frame_of_256() -> None:
    """White is (1, 0, 0) in Lab, each from -1 to 1 here; the raster is half of the reduced frame's."""
    described = sift_matching._describe(np.full((600, 300, 3), 255, np.uint8), sift_matching.DenseSift())
    assert described.shape == (128, 64, 2 * 128 + 3)
    assert_allclose(described[5, 7, -3:], [1, 2 * (128 / 255 - 0.5), 2 * (128 / 255 - 0.5)], atol=1e-5)


@pytest.mark.parametrize(("frames", "sampled"), [(3, [0]), (9, [0, 4, 8]), (40, [0, 5, 10, 15, 20, 25, 30, 35])])
def test_the_reduction_is_of_every_fourth_frame_and_of_eight_at_most(
    frames: int, sampled: list[int], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def described(frame: np.ndarray, _: object) -> np.ndarray:
        return np.full((4, 6, 5), frame.flat[0], np.float32)

    seen = []

    def fit(samples: np.ndarray, channels: int) -> Callable[[np.ndarray], np.ndarray]:
        seen.append(samples[:, 0, 0, 0].tolist())
        assert samples.shape[1:] == (2, 3, 5)  # every other descriptor
        return lambda values: np.repeat(values[..., :1], channels, axis=-1)

    monkeypatch.setattr(sift_matching, "_describe", described)
    monkeypatch.setattr(sift_matching, "fit_reduction", fit)
    clip = clip_of(*(np.full((8, 12, 3), number, np.uint8) for number in range(frames)))
    maps = sift_matching.describe(clip, tmp_path / "described.npy")
    assert seen == [sampled]
    assert maps.shape == (frames, 4, 6, 64)
    assert_array_equal(maps[:, 0, 0, 0], np.arange(frames))

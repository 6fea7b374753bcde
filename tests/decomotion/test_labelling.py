"""Labels from evidence: thresholds, averages along links, and edges of the image."""

from __future__ import annotations

import numpy as np
import pytest

from decomotion.data.masks import labelling
from decomotion.data.masks.evidence import Evidence
from decomotion.data.masks.links import Links

GRID = (4, 6)
POINTS = GRID[0] * GRID[1]
AROUND = range(-4, 5)


def links(shift: float = 0.0, frames: int = 2, confidence: int = 255) -> Links:
    """A clip of 8x12 pixels, a point at the centre of every 2x2 cell, all of which move by `shift` pixels a frame."""
    y, x = np.mgrid[: GRID[0], : GRID[1]].astype(np.float32)
    points = np.stack([2 * x + 0.5, 2 * y + 0.5], axis=-1).reshape(-1, 2)
    frame = np.arange(frames)
    gap = (frame[None] - frame[:, None])[..., None, None]
    targets = (points + gap * np.array([shift, 0])).astype(np.float32)
    given = np.tile(points, (frames, 1, 1)), targets, np.full(targets.shape[:3], confidence, np.uint8)
    return Links(*given, GRID, (8, 12))


class TestOtsu:
    def test_between_two_groups(self):
        assert labelling.otsu(np.array([0, 1, 2, 10, 11, 12], np.float32)) == 6

    def test_slow_twin(self):
        values = np.random.default_rng(0).gamma(1.0, size=200).astype(np.float32)

        def between(threshold: float) -> float:
            low, high = values[values <= threshold], values[values > threshold]
            return len(low) * len(high) * (low.mean() - high.mean()) ** 2

        middles = np.convolve(np.sort(values), [0.5, 0.5], "valid")
        assert labelling.otsu(values) == pytest.approx(max(middles, key=between))

    @pytest.mark.parametrize("values", [[], [3.0]])
    def test_of_too_few(self, values: list[float]):
        assert labelling.otsu(np.array(values, np.float32)) == 0


def test_reading_follows_the_links():
    values = np.tile(np.arange(GRID[1], dtype=np.float32), GRID[0])
    read = links(shift=2.0).read(values, 0, 1).reshape(GRID)
    np.testing.assert_allclose(read[0], [1, 2, 3, 4, 5, 5])


def test_averages_leave_out_what_is_not_known():
    values = np.full((2, POINTS), np.nan, np.float32)
    values[1, :6] = 4
    averaged = labelling.along_links(values, links(), AROUND)
    np.testing.assert_allclose(averaged[:, :6], 4)
    assert np.isnan(averaged[:, 6:]).all()
    averaged = labelling.along_links(np.stack([np.zeros(POINTS), np.ones(POINTS)]).astype(np.float32), links(), AROUND)
    np.testing.assert_allclose(averaged, 0.5)


class TestLogOdds:
    CHANGED = np.full((1, 4), 9, np.float32)

    def test_below_one_unit_nothing_moves(self):
        assert (labelling.log_odds(np.array([[0.1, 0.2, 0.3, 0.9]], np.float32), self.CHANGED) < 0).all()

    def test_the_threshold_rises_with_the_motion(self):
        odds = labelling.log_odds(np.array([[0.1, 2.0, 20.0, 21.0]], np.float32), self.CHANGED)
        assert (odds[0] > 0).tolist() == [False, False, True, True]

    def test_nothing_known_says_nothing(self):
        odds = labelling.log_odds(np.array([[np.nan, 0.1, 5, 5]], np.float32), self.CHANGED)
        assert odds[0, 0] == 0

    def test_motion_that_changes_no_colour_says_nothing(self):
        residual = np.array([[0.1, 5, 5, 5]], np.float32)
        odds = labelling.log_odds(residual, np.array([[0.5, 0.5, 2, np.nan]], np.float32))
        full = labelling.log_odds(residual, self.CHANGED)
        assert odds[0, 0] == full[0, 0] < 0
        np.testing.assert_allclose(odds[0, 1:] / full[0, 1:], [0, 0.5, 0])


class TestMeanField:
    def test_a_lone_point_follows_its_neighbours(self):
        unary = np.full((1, POINTS), -1, np.float32)
        unary[0, 8] = 1
        assert (labelling.mean_field(unary, np.zeros((1, POINTS, 3), np.float32), GRID) < 0.5).all()

    def test_labels_spread_as_far_as_the_colour(self):
        """Evidence at one point each, in two halves of different colour."""
        right = np.tile(np.arange(GRID[1]) >= 3, GRID[0])
        unary = np.zeros((1, POINTS), np.float32)
        unary[0, 0], unary[0, -1] = -3, 3
        lab = np.where(right[:, None], 200.0, 50.0).astype(np.float32) * np.ones(3, np.float32)
        np.testing.assert_array_equal(labelling.mean_field(unary, lab[None], GRID)[0] > 0.5, right)

    def test_frames_are_on_their_own(self):
        unary = np.random.default_rng(0).normal(size=(2, POINTS)).astype(np.float32)
        lab = np.zeros((2, POINTS, 3), np.float32)
        both = labelling.mean_field(unary, lab, GRID)
        np.testing.assert_allclose(both[1:], labelling.mean_field(unary[1:], lab[1:], GRID), rtol=1e-6)


def test_evidence_is_averaged_over_four_frames_to_either_side():
    values = np.zeros((11, POINTS), np.float32)
    values[5] = 9
    averaged = labelling.along_links(values, links(frames=11), AROUND)[:, 0]
    # frames 1 to 9 see the sixth, among five to nine frames
    np.testing.assert_allclose(averaged, [0, 9 / 6, 9 / 7, 9 / 8, 1, 1, 1, 9 / 8, 9 / 7, 9 / 6, 0], rtol=1e-5)


def test_an_average_weighs_links_by_their_confidence():
    values = np.stack([np.zeros(POINTS), np.full(POINTS, 6.0)]).astype(np.float32)
    reader = links()
    reader._confidence[0, 1] = 51
    np.testing.assert_allclose(reader.weight(0, 1), 0.2)
    np.testing.assert_allclose(labelling.along_links(values, reader, AROUND)[0], 6 * 0.2 / 1.2, rtol=1e-5)


def test_doubt_counts_as_links_to_nothing_and_gaps_are_as_asked():
    values = np.arange(5, dtype=np.float32)[:, None] * np.ones(POINTS, np.float32)
    heard = labelling.along_links(values, links(frames=5), (2, -2), doubt=1.0)[:, 0]
    np.testing.assert_allclose(heard, [2 / 2, 3 / 2, (0 + 4) / 3, 1 / 2, 2 / 2])


def test_what_moves_slowly_is_not_measured_by_what_moves_fast_elsewhere_in_the_clip():
    """A threshold is Otsu's of the clip, or of the eight frames to either side where that is lower."""
    residual = np.tile(np.array([0.1, 0.1, 4.0, 0.1], np.float32), (30, 1))
    residual[:10, 2] = 100.0
    found = labelling.thresholds(residual)
    fast, slow = found[0], found[29]
    assert fast == pytest.approx((0.1**0.5 + 10) ** 2 / 4, rel=1e-4)
    assert slow == pytest.approx((0.1**0.5 + 2) ** 2 / 4, rel=1e-4)
    assert found[17] > slow == found[18]


def test_what_stands_for_a_while_moves_with_what_it_is_part_of():
    """Half of the points stand for seven of 35 frames, then move; along links they are the same in all."""
    frames, half = 35, np.tile(np.arange(GRID[1]) < 3, GRID[0])
    residual = np.where(half, np.where(np.arange(frames) < 7, 0.7, 4.0)[:, None], 0.2).astype(np.float32)
    lab = np.where(half[:, None], 200.0, 50.0).astype(np.float32) * np.ones((frames, 1, 3), np.float32)
    evidence = Evidence(residual, np.full_like(residual, 9), np.zeros_like(residual))
    found = labelling.moving_probability(evidence, lab, links(frames=frames))
    assert (found[:, half] > 0.5).all()
    assert (found[:, ~half] < 0.1).all()


def test_where_there_is_no_evidence_labels_are_what_is_heard():
    """Half of the points in one of three frames, of unlike colour; with no links they are on their own."""
    half = np.tile(np.arange(GRID[1]) < 3, GRID[0])
    residual, heard = np.full((3, POINTS), 0.2, np.float32), np.zeros((3, POINTS), np.float32)
    residual[1], heard[1] = np.nan, np.where(half, 0.3, -0.3)
    lab = np.where(half[:, None], 200.0, 50.0).astype(np.float32) * np.ones((3, 1, 3), np.float32)
    evidence = Evidence(residual, np.full_like(residual, 9), heard)
    found = labelling.moving_probability(evidence, lab, links(frames=3, confidence=0))
    np.testing.assert_array_equal(found[1] > 0.5, half)


def test_log_odds_by_hand():
    """1.5 log((r + 0.05) / threshold), the threshold 1 unit, at most 3; a change of 1 voids it, of 3 does not."""
    residual = np.array([[0.2, 0.95, 1.95, 1.95, 1.95, 1e-9, 1e6, 1.95]], np.float32)
    change = np.array([[0.0, 3.0, 3.0, 2.0, 1.0, 9.0, 9.0, 1.5]], np.float32)
    # of two classes those below and above 1e6 / 2 differ most: keep that one out, the threshold is then a unit
    odds = labelling.log_odds(residual[:, [0, 1, 2, 3, 4, 5, 7]], change[:, [0, 1, 2, 3, 4, 5, 7]])
    two = 1.5 * np.log(2)
    expected = [[1.5 * np.log(0.25), 0, two, two / 2, 0, -3, two / 4]]
    np.testing.assert_allclose(odds, expected, atol=1e-4)
    largest = labelling.log_odds(np.array([[0.1, 0.2, 0.1, 1e6]], np.float32), np.full((1, 4), 9, np.float32))
    assert largest[0, 3] == pytest.approx(1.5 * np.log(4), rel=0.01)  # a threshold halfway between square roots


def slow_mean_field(unary: np.ndarray, lab: np.ndarray, rows: int, columns: int) -> np.ndarray:
    """Of one frame, point by point: 20 rounds, half of the old value kept, 2 for a neighbour of the same colour."""

    def apart(p: int, q: int) -> float:
        return float(((lab[p] - lab[q]) ** 2).sum())

    near = {}  # the eight neighbours, and how far they are
    for p in range(rows * columns):
        for q in range(rows * columns):
            down, right = abs(p // columns - q // columns), abs(p % columns - q % columns)
            if p != q and max(down, right) == 1:
                near[p, q] = (down**2 + right**2) ** 0.5
    kinds = {"right": [], "down": [], "falling": [], "rising": []}
    for p, q in near:
        if q == p + 1:
            kinds["right"].append(apart(p, q))
        if q == p + columns:
            kinds["down"].append(apart(p, q))
        if q == p + columns + 1:
            kinds["falling"].append(apart(p, q))
        if q == p + columns - 1:
            kinds["rising"].append(apart(p, q))
    scale = 2 * np.mean([np.mean(kind) for kind in kinds.values()]) + 1e-6
    probability = 1 / (1 + np.exp(-unary))
    for _ in range(20):
        odds = unary.copy()
        for (p, q), length in near.items():
            odds[p] += 2.0 * np.exp(-apart(p, q) / scale) / length * (2 * probability[q] - 1)
        probability = 0.5 * probability + 0.5 / (1 + np.exp(-odds))
    return probability


@pytest.mark.parametrize(("rows", "columns"), [(3, 5), (5, 3)])
def test_mean_field_point_by_point(rows: int, columns: int):
    random = np.random.default_rng(4)
    unary = random.normal(0, 2, rows * columns).astype(np.float32)
    lab = random.uniform(0, 60, (rows * columns, 3)).astype(np.float32)
    found = labelling.mean_field(unary[None], lab[None], (rows, columns))[0]
    expected = slow_mean_field(unary.astype(float), lab.astype(float), rows, columns)
    assert 0 < (expected > 0.5).mean() < 1
    np.testing.assert_allclose(found, expected, atol=1e-4)

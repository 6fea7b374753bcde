"""Linking: exact where the motion is simple, and found again behind an occluder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest

from decomotion.data.links import linking
from decomotion.data.links.linking import Flow, FlowLookup, Links, Moving, Rematching, cycle_error, link, outside
from decomotion.data.links.matcher import Matches

FRAMES, POINTS, HEIGHT, WIDTH = 9, 20, 60, 80
VELOCITY = np.array([1.5, -0.75], np.float32)
THRESHOLD = 1.5

both_ways = pytest.mark.parametrize("step", [1, -1])


def constant_velocity(first: int, second: int) -> Flow:
    return np.broadcast_to((second - first) * VELOCITY, (HEIGHT, WIDTH, 2)).astype(np.float32)


def points_in_the_middle() -> Flow:
    """Other points in each frame, far enough from the border to stay inside for the whole clip."""
    random = np.random.default_rng(0)
    return random.uniform((25, 20), (55, 40), (FRAMES, POINTS, 2)).astype(np.float32)


def run(
    points: Flow, field: FlowLookup, step: int, intervals: tuple[int, ...] = (1, 2, 4), max_gap: int = 1000
) -> dict[int, Links]:
    return {links.target: links for links in link(points, field, intervals, THRESHOLD, max_gap, step)}


@both_ways
@pytest.mark.parametrize("intervals", [(1,), (1, 2, 4), (4, 1, 2), (1, 3)])
def test_constant_velocity_is_exact(step: int, intervals: tuple[int, ...]):
    points = points_in_the_middle()
    linked = run(points, constant_velocity, step, intervals)
    assert set(linked) == set(range(1, FRAMES) if step > 0 else range(FRAMES - 1))
    for target, links in linked.items():
        assert set(links.sources) == set(range(target) if step > 0 else range(target + 1, FRAMES))
        gap = (target - links.sources)[:, None, None]
        # float32, over up to eight hops
        np.testing.assert_allclose(links.xy, points[links.sources] + gap * VELOCITY, atol=1e-4)
        assert not links.occluded.any()


@both_ways
def test_the_cheapest_way_over_the_intervals(step: int):
    cheapest = [0.0]
    for gap in range(1, FRAMES):
        cheapest.append(min(cheapest[gap - hop] + 0.01 + 0.003 * hop**2 for hop in (1, 2, 4) if hop <= gap))
    for target, links in run(points_in_the_middle(), constant_velocity, step).items():
        expected = np.array(cheapest)[np.abs(target - links.sources)][:, None]
        np.testing.assert_allclose(links.variance, np.broadcast_to(expected, links.variance.shape), rtol=1e-4)


@both_ways
@pytest.mark.parametrize("max_gap", [1, 3, 5])
def test_not_beyond_the_longest_gap(step: int, max_gap: int):
    points = points_in_the_middle()

    def field(first: int, second: int) -> Flow:
        assert abs(first - second) <= max_gap, "flow at longer gaps is not computed"
        return constant_velocity(first, second)

    for target, links in run(points, field, step, max_gap=max_gap).items():
        behind = [source for source in range(FRAMES) if 0 < (target - source) * step <= max_gap]
        assert set(links.sources) == set(behind)
        gap = (target - links.sources)[:, None, None]
        np.testing.assert_allclose(links.xy, points[links.sources] + gap * VELOCITY, atol=1e-4)


@both_ways
def test_a_turning_and_growing_image(step: int):
    """Fields linear in x and y are read exactly between pixels too."""
    centre = np.array([40.0, 30.0])
    turn = np.array([[1.01, -0.02], [0.02, 1.01]])

    def carried(xy: Flow, gap: int) -> Flow:
        return ((xy - centre) @ np.linalg.matrix_power(turn, gap).T + centre).astype(np.float32)

    grid = np.stack(np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT)), axis=-1).astype(np.float32)
    points = points_in_the_middle()
    for target, links in run(points, lambda first, second: carried(grid, second - first) - grid, step).items():
        for row, source in enumerate(links.sources):
            # OpenCV reads fields at thirty-seconds of a pixel; these change by at most 0.1 a pixel
            np.testing.assert_allclose(links.xy[row], carried(points[source], target - source), atol=0.02)


def hidden_in(frame: int) -> Callable[[int, int], Flow]:
    """Flow to and from one frame is wrong, and its two ways contradict each other."""

    def field(first: int, second: int) -> Flow:
        right = constant_velocity(first, second)
        if second == frame:
            return right + np.array([6, 0], np.float32)
        return right + np.array([0, 9], np.float32) if first == frame else right

    return field


@both_ways
def test_behind_an_occluder_a_point_is_found_again_by_a_longer_hop(step: int):
    points = points_in_the_middle()
    for target, links in run(points, hidden_in(4), step).items():
        for row, source in enumerate(links.sources):
            if target == 4 or source == 4:
                assert links.occluded[row].all()
            else:
                assert not links.occluded[row].any()
                expected = points[source] + (target - source) * VELOCITY
                np.testing.assert_allclose(links.xy[row], expected, atol=1e-4)


@both_ways
def test_a_visible_way_is_preferred_to_a_better_one_through_a_hidden_place(step: int):
    """Over two frames the short hops disagree by 1.4 units each, the long one, which leads elsewhere, by 1.6."""
    unit = WIDTH / 256

    def field(first: int, second: int) -> Flow:
        gap = abs(first - second)
        astray = np.array([5 * (gap == 2) * np.sign(second - first), 0])
        disagreement = np.array([(1.6 if gap == 2 else 1.4) * unit * ((second - first) * step < 0), 0])
        return (constant_velocity(first, second) + astray + disagreement).astype(np.float32)

    points = points_in_the_middle()[:3]
    links = run(points, field, step, intervals=(1, 2))[2 if step > 0 else 0]
    row = links.sources.tolist().index(0 if step > 0 else 2)
    assert not links.occluded[row].any()
    np.testing.assert_allclose(links.xy[row], points[0 if step > 0 else 2] + 2 * step * VELOCITY, atol=1e-4)


def test_without_a_longer_hop_it_stays_lost():
    for target, links in run(points_in_the_middle(), hidden_in(4), 1, intervals=(1,)).items():
        for row, source in enumerate(links.sources):
            assert links.occluded[row].all() == (source <= 4 <= target)


def test_a_point_that_leaves_the_image_is_flagged():
    points = np.full((FRAMES, 1, 2), 20, np.float32)

    def to_the_left(first: int, second: int) -> Flow:
        return np.broadcast_to(np.array([-6 * (second - first), 0], np.float32), (HEIGHT, WIDTH, 2)).astype(np.float32)

    for target, links in run(points, to_the_left, 1).items():
        for row, source in enumerate(links.sources):
            x = 20 - 6 * (target - source)
            assert links.occluded[row].all() == (x < -0.5)
            if x >= -0.5:
                assert links.xy[row, 0, 0] == pytest.approx(x)


def test_thresholds_are_in_pixels_of_a_256_pixel_frame():
    """The same contradiction of 2 pixels of the raster is 6.4 units in an 80-pixel raster, 1 in a 512-pixel one."""

    def contradicting(height: int, width: int) -> FlowLookup:
        return lambda first, second: np.full((height, width, 2), (2, 0) if second > first else (0, 0), np.float32)

    points = np.full((2, 1, 2), 30, np.float32)
    small, large = (run(points, contradicting(60, width), 1)[1].occluded[0, 0] for width in (80, 512))
    assert small
    assert not large


def test_cycle_error_by_hand():
    forward, backward = np.array([3, 4], np.float32), np.full((HEIGHT, WIDTH, 2), (-3, -2), np.float32)
    xy = np.array([[[10, 10], [20, 10]]], np.float32)
    np.testing.assert_allclose(cycle_error(xy, xy + forward, backward), [[2, 2]], atol=1e-5)


def test_outside_begins_half_a_pixel_beyond_the_outermost_centres():
    xy = np.array([[0, 0], [-0.5, -0.5], [-0.6, 0], [79.5, 59.5], [79.6, 0], [0, 59.6], [0, -0.6]], np.float32)
    assert outside(xy, HEIGHT, WIDTH).tolist() == [False, False, True, False, True, True, True]


@both_ways
@pytest.mark.parametrize(("height", "width"), [(90, 160), (160, 90)])
@pytest.mark.parametrize(
    ("gap", "missed", "cost"),
    [
        (1, 0.0, 0.013),  # 0.1^2 a hop and 0.003 gap^2
        (1, 1.0, 0.313),  # 0.3 of the squared cycle error
        (4, 1.2, 0.49),  # 0.01 + 0.048 + 0.432
        (2, 21.0, 120.022),  # counted up to 20
        (2, 90.0, 120.022),
    ],
)
def test_what_a_hop_costs_by_hand(step: int, height: int, width: int, gap: int, missed: float, cost: float):
    """`missed` is where the way back ends, in units: 0.625 pixels of a raster whose longer side is 160."""

    def field(first: int, second: int) -> Flow:
        way = (second - first) * step
        return np.full((height, width, 2), (0, -missed * 0.625 if way < 0 else 0), np.float32)

    points = np.full((gap + 1, 3, 2), 45, np.float32)
    found = run(points, field, step, intervals=(gap,))[gap if step > 0 else 0]
    np.testing.assert_allclose(found.variance, np.full((1, 3), cost), rtol=1e-4)
    assert found.occluded.all() == (missed > THRESHOLD)


def matched(shift: tuple[float, float], trusted: bool = True) -> Matches:
    """Cells of which 8 lie across and 4 down: of 20x25 pixels in a raster of 160x100."""
    return Matches(np.full((4, 8, 2), shift, np.float32), np.full((4, 8), trusted))


def test_a_match_by_hand():
    """Where flow ends on a hidden place, a match takes the point a cell to the right and half a cell up."""
    points = np.array([[[30, 40], [150, 40], [30, 10]]] * 2, np.float32)
    contradicting = {1: np.zeros((100, 160, 2), np.float32), -1: np.full((100, 160, 2), 10, np.float32)}
    asked = []

    def match(first: int, second: int) -> Matches:
        asked.append((first, second))
        return matched((1, -0.5))

    (links,) = link(
        points, lambda first, second: contradicting[second - first], (1,), THRESHOLD, 9, 1, Rematching(match, (1,))
    )
    assert asked == [(0, 1)]
    np.testing.assert_allclose(links.xy[0], [[50, 27.5], [170, 27.5], [50, -2.5]], atol=1e-4)
    assert links.occluded.tolist() == [[False, True, True]]  # to the right of the image, and above it
    np.testing.assert_allclose(links.variance, 3.0, rtol=1e-5)


@pytest.mark.parametrize(("missed", "taken"), [(3.1, False), (3.2, True)])
def test_a_match_is_taken_where_it_is_cheaper(missed: float, taken: bool):
    """3 against 0.013 + 0.3 e^2: cheaper from a cycle error of 3.155 units on, both ends seen."""
    fields = {1: np.zeros((100, 160, 2), np.float32), -1: np.full((100, 160, 2), (missed * 0.625, 0), np.float32)}
    (links,) = link(
        np.full((2, 1, 2), 40, np.float32),
        lambda first, second: fields[second - first],
        (1,),
        5.0,
        9,
        1,
        Rematching(lambda *_: matched((0, 0.25)), (1,)),
    )
    assert links.xy[0, 0].tolist() == [40, 46.25 if taken else 40]
    assert not links.occluded.any()


def test_a_match_that_is_not_trusted_is_hidden_too():
    fields = {1: np.zeros((100, 160, 2), np.float32), -1: np.full((100, 160, 2), 2, np.float32)}
    points = np.full((2, 1, 2), 40, np.float32)
    (links,) = link(
        points,
        lambda first, second: fields[second - first],
        (1,),
        THRESHOLD,
        9,
        1,
        Rematching(lambda *_: matched((0, 0.25), False), (1,)),
    )
    # both are hidden: the cheaper one, 3 against 0.013 + 0.3 * (2 * 2^0.5 * 1.6)^2 = 6.16
    assert links.xy[0, 0].tolist() == [40, 46.25]
    assert links.occluded.all()


@both_ways
def test_points_are_carried_some_at_a_time(step: int, monkeypatch: pytest.MonkeyPatch):
    """In parts that divide neither frames nor points, gathered or not, with what is found again and refined."""
    random = np.random.default_rng(0)
    away = random.normal(0, 3, (FRAMES, FRAMES, 6, 8, 2)).astype(np.float32)
    points = random.uniform((0, 0), (WIDTH - 1, HEIGHT - 1), (FRAMES, POINTS, 2)).astype(np.float32)
    cells = random.normal(0, 0.5, (FRAMES, FRAMES, 3, 4, 2)).astype(np.float32)

    def field(first: int, second: int) -> Flow:
        return cv2.resize(away[first, second] * (0.1 if abs(first - second) == 1 else 1), (WIDTH, HEIGHT))

    def linked() -> list[Links]:
        again = Rematching(
            lambda first, second: Matches(cells[first, second], cells[first, second, ..., 0] > 0),
            (2, 3),
            lambda first, second, xy, found, _: (0.9 * found + 0.1 * xy + first - second).astype(np.float32),
        )
        return list(link(points, field, (1, 2, 4), THRESHOLD, 6, step, again))

    whole = linked()
    assert 0.1 < np.mean([links.occluded.mean() for links in whole]) < 0.9
    for most in (0.0, 1.1):
        monkeypatch.setattr(linking, "AT_ONCE", 7)
        monkeypatch.setattr(linking, "MOST", most)
        for links, expected in zip(linked(), whole, strict=True):
            np.testing.assert_array_equal(links.sources, expected.sources)
            np.testing.assert_allclose(links.xy, expected.xy, atol=1e-4)
            np.testing.assert_allclose(links.variance, expected.variance, rtol=1e-5)
            np.testing.assert_array_equal(links.occluded, expected.occluded)


@pytest.mark.parametrize(("missed", "long_hop"), [(4.4, False), (4.5, True)])
def test_a_hidden_place_costs_ten_squared_units(missed: float, long_hop: bool):
    """Three visible hops, 3 (0.013 + 0.3 e^2), or a hidden one that misses by 5.1: 0.037 + 0.3 * 5.1^2 + 10 = 17.84."""

    def field(first: int, second: int) -> Flow:
        off = 5.1 if abs(second - first) == 3 else missed
        return np.full((60, 80, 2), (0 if second > first else off * 80 / 256, 0), np.float32)

    points = np.full((4, 1, 2), 30, np.float32)
    links = {each.target: each for each in link(points, field, (1, 3), 5.0, 9, 1)}[3]
    assert links.sources.tolist() == [0, 1, 2]
    assert links.occluded[0, 0] == long_hop


class TestMoving:
    """A limb goes by `VELOCITY`, and the scene stands still, which flow takes to be so of the limb too."""

    @staticmethod
    def limb(frame: int, margin: int = 0) -> np.ndarray:
        left = 30 + 2 * frame - margin
        mask = np.zeros((HEIGHT, WIDTH), np.bool_)
        mask[:, left : left + 10 + 2 * margin] = True
        return mask

    @staticmethod
    def nowhere(_: int) -> np.ndarray:
        return np.zeros((HEIGHT, WIDTH), np.bool_)

    def moving(self, speed: float) -> Moving:
        def alone(first: int, second: int) -> Flow:
            return np.broadcast_to(np.float32([speed * (second - first), 0]), (HEIGHT, WIDTH, 2)).astype(np.float32)

        return Moving(alone, self.limb, lambda frame: self.limb(frame, 1))

    @staticmethod
    def still(first: int, second: int) -> Flow:
        """The farther apart frames are the worse it returns: what goes another way has no need to wait for long."""
        return np.full((HEIGHT, WIDTH, 2), 0.1 * (second > first), np.float32)

    def points(self) -> Flow:
        """Six before each limb, and the last two on it, in all frames."""
        return np.stack([[(5.0 + 3 * n, 20 + n) for n in range(6)] + [(34.0 + 2 * frame, 30), (36.0 + 2 * frame, 9)]
                         for frame in range(FRAMES)]).astype(np.float32)  # fmt: skip

    @both_ways
    def test_it_goes_by_itself_and_the_scene_with_the_rest(self, step: int):
        points = self.points()
        for links in link(points, self.still, (1, 2), THRESHOLD, 9, step, None, self.moving(2)):
            gap = (links.target - links.sources)[:, None]
            np.testing.assert_allclose(links.xy[:, 6:, 0], points[links.sources, 6:, 0] + 2 * gap, atol=1e-4)
            np.testing.assert_allclose(links.xy[:, :6], points[links.sources, :6], atol=0.1 * FRAMES)
            assert not links.occluded.any()

    @both_ways
    def test_to_and_from_a_frame_without_a_mask_it_goes_with_the_rest(self, step: int):
        nothing, points = np.zeros((HEIGHT, WIDTH), np.bool_), self.points()
        masks = [nothing if frame == 4 else self.limb(frame) for frame in range(FRAMES)]
        moving = Moving(self.moving(2).flow, masks.__getitem__, lambda _: ~nothing)
        for links in link(points, self.still, (1,), THRESHOLD, 2, step, None, moving):
            for source, xy in zip(links.sources, links.xy[:, 6:, 0], strict=True):
                hops = [(frame, frame + step) for frame in range(source, links.target, step)]
                expected = sum(2 * step for hop in hops if source != 4 and 4 not in hop)
                np.testing.assert_allclose(xy - points[source, 6:, 0], expected, atol=0.3)

    @both_ways
    def test_what_leaves_the_masks_is_hidden(self, step: int):
        """By the flow of all it stays behind, by its own it goes too far."""
        for links in link(self.points(), self.still, (1, 2), THRESHOLD, 9, step, None, self.moving(20)):
            far = np.abs(links.target - links.sources) > 4
            assert links.occluded[far][:, 6:].all()
            assert not links.occluded[:, :6].any()

    @both_ways
    @pytest.mark.parametrize(
        ("brighter", "ends", "hidden"), [(0, True, False), (35, True, False), (37, True, True), (37, False, False)]
    )
    def test_but_for_a_place_that_looks_as_it_does(self, step: int, brighter: int, ends: bool, hidden: bool):
        """Its masks reach nowhere, or what ends is not known. One channel of three is so much brighter above."""

        def look(frame: int) -> np.ndarray:
            image = np.full((HEIGHT, WIDTH, 3), 100, np.uint8)
            image[:15, :, 1] += np.uint8(brighter * (frame % 2))
            return image

        moving = replace(self.moving(2), look=look, reach=self.nowhere if ends else None)
        for links in link(self.points(), self.still, (1,), THRESHOLD, 1, step, None, moving):
            assert (links.occluded[:, 6:] == (False, hidden)).all()
            assert not links.occluded[:, :6].any()

    @both_ways
    def test_a_point_is_compared_as_it_looks_in_its_own_frame(self, step: int):
        """Each frame is a little brighter than the last: over two hops, of which none is too much, it is."""

        def look(frame: int) -> np.ndarray:
            return np.full((HEIGHT, WIDTH, 3), 50 + 8 * frame, np.uint8)

        moving = replace(self.moving(2), look=look, reach=self.nowhere)
        for links in link(self.points(), self.still, (1,), THRESHOLD, 4, step, None, moving):
            far = np.abs(links.target - links.sources) > 1
            assert links.occluded[far][:, 6:].all()
            assert not links.occluded[~far][:, 6:].any()
            assert not links.occluded[:, :6].any()

    @both_ways
    def test_nor_do_matches_lead_out_of_them(self, step: int):
        """Flow finds nothing, matches say that all has stayed."""
        lost = np.full((HEIGHT, WIDTH, 2), 5, np.float32)
        cells = Matches(
            np.zeros((HEIGHT // 4, WIDTH // 4, 2), np.float32), np.ones((HEIGHT // 4, WIDTH // 4), np.bool_)
        )
        moving = Moving(lambda *_: lost, self.limb, lambda frame: self.limb(frame, 1))
        again = Rematching(lambda *_: cells, (6,))
        for links in link(self.points(), lambda *_: lost, (1,), THRESHOLD, 6, step, again, moving):
            far = np.abs(links.target - links.sources) == 6
            assert links.occluded[:, 6:].all()
            assert not links.occluded[far][:, :6].any()
            assert links.occluded[~far].all()

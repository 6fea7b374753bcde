"""Outlines by a network: what is its to say, and what stays the links'."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from decomotion.data.masks import outlines
from decomotion.data.masks.links import Links
from decomotion.data.masks.outlines import (
    DOUBT,
    RIM,
    SHARE,
    asked,
    boxes,
    but_for_scene,
    everywhere,
    outline,
    outlined,
    stands_out,
    voted,
)
from decomotion.data.masks.scene import LEAST
from decomotion.data.pool import jittered_grid

HEIGHT, WIDTH = 120, 256
"""One pixel is one unit."""


def filled(*parts: tuple[slice, slice], shape: tuple[int, int] = (HEIGHT, WIDTH)) -> np.ndarray:
    mask = np.zeros(shape, np.bool_)
    for part in parts:
        mask[part] = True
    return mask


BODY = (slice(40, 60), slice(50, 90))
TAIL = (slice(48, 50), slice(90, 105))


class TestOutline:
    def test_what_hangs_together_moves_as_one(self):
        """However far a limb reaches."""
        limb = (slice(48, 50), slice(90, 250))
        np.testing.assert_array_equal(outline(filled(BODY), filled(BODY, limb)), filled(BODY, limb))

    @pytest.mark.parametrize("moves", [True, False])
    def test_where_a_fair_share_of_it_is_in_the_mask(self, moves: bool):
        """A bush of which the mask holds somewhat more than `SHARE`, or less."""
        bush, share = (slice(20, 40), slice(100, 120)), 100 + int(20 * SHARE) + (1 if moves else -1)
        mask = filled(BODY, (slice(20, 40), slice(100, share)))
        np.testing.assert_array_equal(outline(mask, filled(BODY, bush)), filled(BODY, bush) if moves else mask)

    def test_the_blurred_rim_of_what_is_outlined_goes(self):
        """As far as `RIM`, and all of it stays where it reaches farther: a shadow, which the network leaves out."""
        narrow, wide = (filled((slice(40, 60), slice(50, 90 + margin))) for margin in (int(RIM), int(RIM) + 1))
        np.testing.assert_array_equal(outline(narrow, filled(BODY)), filled(BODY))
        np.testing.assert_array_equal(outline(wide, filled(BODY)), wide)

    def test_the_rim_is_in_units(self):
        """A frame three times as large, and higher than wide."""
        large, body = {"shape": (WIDTH * 3, HEIGHT * 3)}, (slice(200, 300), slice(60, 120))
        for margin, goes in ((3 * int(RIM), True), (3 * int(RIM) + 1, False)):
            mask = filled((slice(200, 300), slice(60, 120 + margin)), **large)
            np.testing.assert_array_equal(outline(mask, filled(body, **large)), filled(body, **large) if goes else mask)

    def test_what_moves_and_is_not_outlined_stays(self):
        ball = (slice(80, 88), slice(150, 158))
        np.testing.assert_array_equal(outline(filled(BODY, ball), filled(BODY)), filled(BODY, ball))

    @pytest.mark.parametrize("mask", [filled(), filled(BODY)])
    def test_a_network_that_sees_nothing_changes_nothing(self, mask: np.ndarray):
        np.testing.assert_array_equal(outline(mask, np.zeros_like(mask)), mask)

    def test_nothing_moves(self):
        assert not outline(filled(), filled(BODY)).any()


class TestBoxes:
    def test_around_a_part_as_much_again_on_each_side(self):
        """In the frame: what lies beyond an edge is shown on the other side."""
        (box,) = boxes(filled((slice(50, 60), slice(100, 122))))
        assert box == (slice(16, 94), slice(66, 156))  # 18x30 with what is together, and 30 around
        (box,) = boxes(filled((slice(0, 10), slice(230, 256))))
        assert box == (slice(0, 74), slice(166, 256))

    def test_a_large_part_has_the_whole_frame(self):
        assert boxes(filled((slice(10, 110), slice(20, 230)))) == [(slice(0, HEIGHT), slice(0, WIDTH))]

    def test_the_two_largest_that_are_not_small(self):
        parts = [(slice(5, 5 + side), slice(left, left + side)) for side, left in ((20, 10), (30, 80), (10, 160))]
        assert [box[1].start for box in boxes(filled(*parts))] == [80 - 4 - 38, 0]
        assert boxes(filled((slice(50, 53), slice(50, 53)))) == []
        assert boxes(filled()) == []

    def test_neighbours_are_looked_at_together(self):
        assert len(boxes(filled((slice(40, 60), slice(50, 70)), (slice(40, 60), slice(77, 97))))) == 1
        assert len(boxes(filled((slice(40, 60), slice(50, 70)), (slice(40, 60), slice(80, 100))))) == 2


def test_each_part_is_shown_and_the_larger_value_counts():
    frame = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    frame[..., 0] = np.arange(WIDTH)
    shown = []

    def network(picture: np.ndarray) -> np.ndarray:
        assert picture.flags.c_contiguous
        shown.append((picture.shape[0], picture[0, 0, 0], picture[0, -1, 0]))
        return np.full(picture.shape[:2], 0.25 * len(shown), np.float32)

    found = stands_out(frame, filled((slice(40, 60), slice(50, 80)), (slice(40, 60), slice(100, 120))), network)
    assert shown == [(104, 8, 121), (84, 68, 151)]
    assert (found[60, 20], found[60, 100], found[60, 140], found[60, 200]) == (0.25, 0.5, 0.5, 0)


class TestWithoutTheScene:
    """What is found beside the body: a part of 10 by 10 that looks like the scene in so many columns."""

    BESIDE = (slice(45, 55), slice(90, 100))

    @pytest.mark.parametrize(("columns", "stays"), [(0, True), (4, True), (6, False), (10, False)])
    def test_what_looks_like_it_for_the_most_part_goes(self, columns: int, stays: bool):
        different = np.full((HEIGHT, WIDTH), LEAST + 1, np.float32)
        different[:, 90 : 90 + columns] = LEAST - 1
        found = but_for_scene(filled(BODY, self.BESIDE), filled(BODY), different)
        np.testing.assert_array_equal(found, filled(BODY, self.BESIDE) if stays else filled(BODY))

    def test_where_it_is_not_known_nothing_does(self):
        different = np.full((HEIGHT, WIDTH), np.nan, np.float32)
        np.testing.assert_array_equal(
            but_for_scene(filled(BODY, self.BESIDE), filled(BODY), different), filled(BODY, self.BESIDE)
        )

    def test_what_links_tell_to_move_stays(self):
        different = np.zeros((HEIGHT, WIDTH), np.float32)
        np.testing.assert_array_equal(but_for_scene(filled(BODY), filled(BODY), different), filled(BODY))

    def test_each_part_by_itself_and_on_a_finer_raster(self):
        above, below = (slice(60, 80), slice(180, 200)), (slice(120, 140), slice(180, 200))
        body = (slice(80, 120), slice(100, 180))
        different = np.full((HEIGHT, WIDTH), LEAST + 1, np.float32)
        different[60:70] = LEAST - 1
        large = {"shape": (2 * HEIGHT, 2 * WIDTH)}
        found = but_for_scene(filled(body, above, below, **large), filled(body, **large), different)
        np.testing.assert_array_equal(found, filled(body, above, **large))


FRAMES = 10


class TestVoted:
    """Points of a scene that stands still, in frames of 72x128, of which masks are read at 144x256 and at 36x64."""

    GRID = (18, 32)
    SIDES = (72, 128)

    def links(self, known: float = 1.0) -> Links:
        points = jittered_grid(FRAMES, *self.SIDES, 18 * 32, np.random.default_rng(3))
        targets = np.broadcast_to(points[:, None], (FRAMES, FRAMES, *points.shape[1:])).copy()
        return Links(points, targets, np.full(targets.shape[:3], 255 * known, np.uint8), self.GRID, self.SIDES)

    @pytest.mark.parametrize("scale", [0.5, 2])
    def test_what_the_frames_around_found_overrules_a_point(self, scale: float):
        """A thing in all masks but one, whose probability is low in that frame as well."""
        thing = tuple(slice(int(begin * scale), int(end * scale)) for begin, end in ((16, 40), (64, 96)))
        masks = [filled(thing, shape=tuple(int(side * scale) for side in self.SIDES)) for _ in range(FRAMES)]
        masks[4] = np.zeros_like(masks[4])
        found = voted(np.full((FRAMES, *self.GRID), 0.2, np.float32), masks, self.links())
        assert found[:, 5:9, 17:23].min() > 0.9  # cells of 4x4
        outside = np.ones(self.GRID, np.bool_)
        outside[3:11, 15:25] = False
        assert found[:, outside].max() < 0.01

    def test_far_away_frames_are_heard(self):
        """In one half of a clip of 24 frames."""
        masks = [filled((slice(16, 40), slice(64, 96)), shape=self.SIDES)] * 3 + [filled(shape=self.SIDES)] * 7
        found = voted(np.full((FRAMES, *self.GRID), 0.5, np.float32), masks, self.links())
        assert found[9, 6, 18] > found[9, 2, 2]
        np.testing.assert_allclose(found[9, 2, 2], found[9, 15, 30], atol=1e-3)

    def test_without_links_probabilities_stay(self):
        """But for a doubt where they are sure."""
        probability = np.random.default_rng(1).uniform(0, 1, (FRAMES, *self.GRID)).astype(np.float32)
        masks = [filled((slice(16, 40), slice(64, 96)), shape=self.SIDES)] * FRAMES
        np.testing.assert_allclose(
            voted(probability, masks, self.links(known=0)), np.clip(probability, DOUBT, 1 - DOUBT), atol=1e-5
        )


def test_what_stands_for_a_while_is_the_same_thing():
    """A red thing that by its links moves in the first frames only; in the last it has the corners of the grid."""
    thing, grid = filled((slice(20, 36), slice(40, 60)), shape=TestVoted.SIDES), (36, 64)
    frames = np.full((FRAMES, *TestVoted.SIDES, 3), 90, np.uint8)
    frames[:, thing] = (255, 60, 60)
    points = jittered_grid(FRAMES, *TestVoted.SIDES, 36 * 64, np.random.default_rng(4))
    targets = np.broadcast_to(points[:, None], (FRAMES, FRAMES, *points.shape[1:])).copy()
    links = Links(points, targets, np.full(targets.shape[:3], 255, np.uint8), grid, TestVoted.SIDES)
    likely = np.zeros((FRAMES, *grid), np.float32)
    likely[: FRAMES - 2, 10:18, 20:30] = 1
    random = np.random.default_rng(0)
    found = outlined(frames, likely, links, lambda red: np.where(red[..., 0] > 200, 0.51, 0.49), random)
    for mask in found:
        assert (mask ^ thing).mean() < 0.01  # the thing has 0.035


def test_outlines_are_the_network_s_but_for_a_bystander():
    """A red body slides over a scene that stands; beside its way stands another red thing, which it touches at times.

    Of the body the probability knows the middle alone, on a coarse grid. Frames are 144x256.
    """
    random = np.random.default_rng(2)
    scene = cv2.GaussianBlur(random.uniform(0, 255, (144, 256, 3)), (0, 0), 2)
    scene = np.clip(128 + 4 * (scene - 128), 0, 255).astype(np.uint8)
    scene[..., 0] //= 3
    bystander, bodies = filled((slice(64, 74), slice(130, 140)), shape=(144, 256)), []
    scene[bystander, 0] = 255
    frames = np.repeat(scene[None], FRAMES, axis=0)
    for frame in range(FRAMES):
        left = 40 + 12 * frame
        trunk, limb = (slice(40, 64), slice(left, left + 30)), (slice(30, 40), slice(left + 4, left + 7))
        bodies.append(filled(trunk, limb, shape=(144, 256)))
        frames[frame, bodies[-1]] = (255, 60, 60)
    grid = (36, 64)
    points = jittered_grid(FRAMES, 144, 256, 36 * 64, random)
    x, y = np.round(points).astype(int).transpose(2, 0, 1)
    moves = np.stack([body[40:64].any(0)[x[k]] & (y[k] >= 40) & (y[k] < 64) for k, body in enumerate(bodies)])
    away = np.arange(FRAMES)[None] - np.arange(FRAMES)[:, None]
    speed = np.where(moves[..., None], np.float32([12, 0]), np.float32([0, 0]))
    targets = (points[:, None] + away[..., None, None] * speed[:, None]).astype(np.float32)
    links = Links(points, targets, np.full(targets.shape[:3], 255, np.uint8), grid, (144, 256))
    likely = moves.reshape(FRAMES, *grid).astype(np.float32)
    masks = list(outlined(frames, likely, links, lambda red: np.where(red[..., 0] > 200, 0.51, 0.49), random))
    touches = [cv2.dilate(body.view(np.uint8), np.ones((3, 3), np.uint8))[bystander].any() for body in bodies]
    assert 1 < sum(touches) < FRAMES // 2
    for mask, body in zip(masks, bodies, strict=True):
        assert mask[body].mean() > 0.95
        assert (mask & ~body).sum() <= 4  # of a hundred of the bystander


def moved(*, frames: int, sides: tuple[int, int] = (90, 160), speed: tuple[float, float] = (6.0, 2.0)) -> Links:
    """Links of a coarse grid over which all moves at one speed, in pixels a frame; sides are not those of units."""
    points = jittered_grid(frames, *sides, 9 * 16, np.random.default_rng(3))
    away = np.arange(frames)[None] - np.arange(frames)[:, None]
    targets = (points[:, None] + away[..., None, None] * np.float32(speed)).astype(np.float32)
    return Links(points, targets, np.full(targets.shape[:3], 255, np.uint8), (9, 16), sides)


def blob(frame: int, sides: tuple[int, int] = (90, 160)) -> np.ndarray:
    """What stands out at (40, 30) in frame 0 and goes with `moved`."""
    x, y = np.meshgrid(np.arange(sides[1]), np.arange(sides[0]))
    return np.exp(-((x - 40 - 6 * frame) ** 2 + (y - 30 - 2 * frame) ** 2) / 50).astype(np.float32)


@pytest.mark.parametrize(("frames", "apart"), [(1, 1), (64, 1), (65, 2), (128, 2), (129, 3)])
def test_the_network_is_asked_of_at_most_so_many_frames_evenly_spread(frames: int, apart: int):
    assert list(asked(frames)) == list(range(0, frames, apart))


@pytest.mark.parametrize("told", [(0, 2, 4), (0, 3, 5)])
def test_frames_that_are_not_asked_have_what_their_neighbours_were_told_where_links_bring_it(told: tuple[int, ...]):
    """Those after the last have it of that alone."""
    found = list(everywhere({frame: blob(frame) for frame in told}, moved(frames=7)))
    assert len(found) == 7
    for frame, each in enumerate(found):
        np.testing.assert_allclose(each, blob(frame), atol=0 if frame in told else 0.01)


def test_the_nearer_neighbour_counts_more():
    told = {0: np.zeros((90, 160), np.float32), 3: blob(3)}
    found = list(everywhere(told, moved(frames=4)))
    np.testing.assert_allclose(found[1], blob(1) / 3, atol=0.01)
    np.testing.assert_allclose(found[2], blob(2) * 2 / 3, atol=0.01)


def test_of_a_long_clip_the_network_is_asked_of_every_second_frame(monkeypatch: pytest.MonkeyPatch):
    """Twice outlined, once asked."""
    monkeypatch.setattr(outlines, "MOST", 4)
    frames = np.full((7, 90, 160, 3), 90, np.uint8)
    frames[np.arange(7), 40, 40] = np.arange(7)[:, None]  # tells them apart
    seen: list[int] = []

    def network(picture: np.ndarray) -> np.ndarray:
        seen.append(int(picture[picture != 90].max(initial=0)))
        return np.zeros(picture.shape[:2], np.float32)

    likely = np.zeros((7, 9, 16), np.float32)
    likely[:, 3:6, 3:6] = 1
    masks = list(outlined(frames, likely, moved(frames=7, speed=(0, 0)), network, np.random.default_rng(0)))
    assert len(masks) == 7
    assert seen == [0, 2, 4, 6]

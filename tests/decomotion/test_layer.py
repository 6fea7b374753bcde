"""The layer of what moves: its flow by itself, and where it can be."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from decomotion import config
from decomotion.data.flow import Flow, Frame, build_flow
from decomotion.data.links.layer import DRAWN_TOLERANCE, GREY, Layer, Mask

HEIGHT, WIDTH = 80, 128
"""A unit is half a pixel."""
SIZE = (WIDTH, HEIGHT)


def box(rows: slice, columns: slice) -> Mask:
    mask = np.zeros((HEIGHT, WIDTH), np.bool_)
    mask[rows, columns] = True
    return mask


class Noting:
    """Says that all moves by (1, 2), and notes what it is shown."""

    concurrent, guided, field_side = True, True, 512

    def __init__(self) -> None:
        self.asked: list[tuple[Frame, Frame, tuple[int, int]]] = []

    def __call__(self, first: Frame, second: Frame, pair: tuple[int, int], start: Flow | None = None) -> Flow:
        self.asked.append((first, second, pair))
        return np.broadcast_to(np.float32([1, 2]), (*first.shape[:2], 2)).copy()

    def effort(self, gap: int) -> float:
        return 1.0

    def require(self, pairs: list[tuple[int, int]]) -> None:
        """Any."""


def test_a_limb_moves_as_it_does_and_not_as_what_is_behind_it() -> None:
    """A bar four pixels wide, blurred, before a scene of strong texture, goes 6 pixels right and 2 down."""
    random = np.random.default_rng(1)
    scene = cv2.GaussianBlur(random.uniform(0, 255, (HEIGHT, WIDTH, 3)), (0, 0), 1.5)
    scene = np.clip(128 + 4 * (scene - 128), 0, 255)
    limb = 150 + cv2.GaussianBlur(random.uniform(-1, 1, (40, 4)), (0, 0), 1.5)[..., None] * np.float32([90, 90, 90])
    frames, masks = [], []
    for x, y in ((50, 20), (56, 22)):
        masks.append(box(slice(y, y + 40), slice(x, x + 4)))
        frames.append(scene.copy())
        frames[-1][masks[-1]] = limb.reshape(-1, 3)
    first, second = (frame.astype(np.uint8) for frame in frames)
    estimator = build_flow(config.load("cpu", flow="dis").data.flow)
    true, middle = np.float32([6, 2]), (slice(24, 56), slice(51, 53))
    alone = Layer(masks, SIZE).flow(estimator, (first, second), (0, 1))
    assert (np.linalg.norm(alone[middle] - true, axis=-1) < 1).mean() > 0.9
    assert (np.linalg.norm(estimator(first, second, (0, 1))[middle] - true, axis=-1) < 1).mean() < 0.5


def test_only_what_moves_is_shown_and_only_the_part_that_it_fills() -> None:
    """16 units are 8 pixels, fewer at the border."""
    masks = [box(slice(2, 30), slice(40, 50)), box(slice(10, 33), slice(44, 60))]
    frames = np.full((2, HEIGHT, WIDTH, 3), 7, np.uint8)
    estimator = Noting()
    flow = Layer(masks, SIZE).flow(estimator, (frames[1], frames[0]), (1, 0))
    ((first, second, pair),) = estimator.asked
    part = (slice(0, 41), slice(32, 68))
    assert pair == (1, 0)
    for shown, mask in ((first, masks[1]), (second, masks[0])):
        np.testing.assert_array_equal(shown, np.where(mask[part][..., None], frames[0][part], GREY))
    np.testing.assert_array_equal(flow[part], np.broadcast_to([1, 2], (41, 36, 2)))
    flow[part] = 0
    assert not flow.any()


@pytest.mark.parametrize("pair", [(0, 1), (1, 0)])
def test_where_a_frame_has_nothing_there_is_nothing_to_search(pair: tuple[int, int]) -> None:
    layer = Layer([box(slice(10, 30), slice(40, 50)), box(slice(0), slice(0))], SIZE)
    estimator, frame = Noting(), np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    assert not layer.flow(estimator, (frame, frame), pair).any()
    assert not estimator.asked
    assert layer.effort() == 36 * 26 / (2 * HEIGHT * WIDTH)


def test_nothing_beyond_the_border_is_searched() -> None:
    """In the lower right corner 8 pixels around are there on two sides alone."""
    layer = Layer([box(slice(70, 80), slice(100, 128))], SIZE)
    assert layer.part(0, 0) == (slice(62, 80), slice(92, 128))
    assert layer.effort() == 18 * 36 / (HEIGHT * WIDTH)


@pytest.mark.parametrize(("tolerance", "pixels"), [((), 2), ((DRAWN_TOLERANCE,), 4)])
def test_what_moves_lies_as_near_its_mask_as_that_is_right_and_anywhere_without_one(
    tolerance: tuple[float, ...], pixels: int
) -> None:
    """On a raster of 512 pixels a unit is two."""
    masks = [np.zeros((288, 512), np.bool_) for _ in range(2)]
    masks[0][100, 200] = True
    layer = Layer(masks, (512, 288), *tolerance)
    y, x = np.mgrid[:288, :512]
    np.testing.assert_array_equal(layer.reach(0), np.hypot(x - 200, y - 100) <= pixels)
    np.testing.assert_array_equal(layer.mask(0), masks[0])
    assert layer.reach(1).all()


def test_masks_and_frames_of_another_size_are_brought_to_the_raster() -> None:
    big = np.zeros((4 * HEIGHT, 4 * WIDTH), np.bool_)
    big[40:120, 80:200] = True
    layer, estimator = Layer([big, big], SIZE), Noting()
    np.testing.assert_array_equal(layer.mask(1), box(slice(10, 30), slice(20, 50)))
    frame = np.zeros((2 * HEIGHT, 2 * WIDTH, 3), np.uint8)
    assert layer.flow(estimator, (frame, frame), (0, 1)).shape == (HEIGHT, WIDTH, 2)
    assert estimator.asked[0][0].shape == (36, 46, 3)

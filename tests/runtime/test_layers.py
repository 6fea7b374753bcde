from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from decomo_runtime import Appearance, QueryError, RenderError, Tracker
from decomo_runtime.contract import FARTHEST, HOLE, LAYERS
from decomo_runtime.layers import picture, pixel_queries, raster_size, render

NUM_FRAMES, HEIGHT, WIDTH = 6, 40, 48


def seen(**given: Any) -> Appearance:
    """What is seen at the two pixels of a 1x2 picture."""
    colour, scalar = np.zeros((2, 3), np.float32), np.zeros(2, np.float32)
    values = {"rgb": colour, "rgb_static": colour, "rgb_dynamic": colour, "static_confidence": scalar, "depth": scalar}
    values["static_opacity"] = scalar
    return Appearance(**(values | {name: np.array(value, np.float32) for name, value in given.items()}))


def test_every_pixel_is_asked_for_at_its_centre(tracker: Tracker):
    """One query after the other, the slow way."""
    image = render(tracker, 2)[0]
    assert image.shape == (HEIGHT, WIDTH, 3)
    assert image.dtype == np.uint8
    for y, x in ((0, 0), (0, WIDTH - 1), (17, 30), (HEIGHT - 1, WIDTH - 1)):
        np.testing.assert_array_equal(image[y, x], np.rint(255 * tracker.sample([(2, x, y)]).rgb[0]))


@pytest.mark.parametrize(("long_side", "shape"), [(24, (20, 24)), (96, (80, 96)), (1, (1, 1)), (None, (40, 48))])
def test_another_size_covers_the_same_area(tracker: Tracker, long_side: int | None, shape: tuple[int, int]):
    assert raster_size(tracker.facts, long_side) == shape
    queries = pixel_queries(3, shape, tracker.facts)
    np.testing.assert_array_equal(queries[:, 0], 3)
    steps = np.array([WIDTH / shape[1], HEIGHT / shape[0]])
    np.testing.assert_allclose(queries[0, 1:], steps / 2 - 0.5, atol=1e-5)
    np.testing.assert_allclose(queries[-1, 1:], [WIDTH - 0.5, HEIGHT - 0.5] - steps / 2, atol=1e-5)
    assert render(tracker, 3, ["mask"], long_side=long_side)[0].shape == (*shape, 3)


def test_layers_of_a_frame_are_asked_for_once(tracker: Tracker, monkeypatch: pytest.MonkeyPatch):
    asked = []
    sample = tracker.sample
    monkeypatch.setattr(tracker, "sample", lambda queries: asked.append(len(queries)) or sample(queries))
    pictures = render(tracker, 1, LAYERS)
    assert asked == [HEIGHT * WIDTH]
    assert [each.shape[2] for each in pictures] == [3, 4, 4, 3, 3]
    for layer, each in zip(LAYERS, pictures, strict=True):
        np.testing.assert_array_equal(render(tracker, 1, [layer])[0], each)


def test_the_mask_is_white_on_what_moves():
    mask = picture(seen(static_confidence=[1, 0.2]), "mask", (1, 2))
    assert mask.tolist() == [[[0, 0, 0], [204, 204, 204]]]


def test_objects_are_opaque_where_nothing_is_static():
    objects = picture(seen(rgb_dynamic=[[1, 0, 0], [0, 1, 0]], static_confidence=[1, 0.2]), "dynamic", (1, 2))
    assert objects.tolist() == [[[255, 0, 0, 0], [0, 255, 0, 204]]]


def test_the_scene_is_transparent_where_it_has_a_hole():
    scene = picture(seen(rgb_static=[[1, 0, 0], [0, 1, 0]], static_opacity=[HOLE, HOLE / 5]), "static", (1, 2))
    assert scene.tolist() == [[[255, 0, 0, 255], [0, 255, 0, 51]]]


def test_depth_goes_from_bright_to_dark_on_one_scale():
    depths = np.linspace(0, FARTHEST, 2)
    luma = picture(seen(depth=depths), "depth", (1, 2)) @ [0.299, 0.587, 0.114]
    assert luma[0, 0] > 200
    assert luma[0, 1] < 10


@pytest.mark.parametrize("value", [-1.0, 2.0, np.nan, np.inf])
def test_what_is_out_of_range_does_not_wrap(value: float):
    image = picture(seen(rgb=[[value] * 3, [0.5] * 3]), "fused", (1, 2))
    assert image[0, 0, 0] in (0, 255)
    assert image[0, 1].tolist() == [128] * 3


def test_bad_requests(tracker: Tracker):
    with pytest.raises(RenderError, match="there is no layer 'sky'; choose from fused, static"):
        render(tracker, 0, ["sky"])
    with pytest.raises(RenderError, match=re.escape("such as ['static']; got 'static'")):
        render(tracker, 0, "static")
    with pytest.raises(QueryError, match=r"it must be within 0 \.\. 5"):
        render(tracker, 6)
    for wrong in (0, -3, 2.5, True):
        with pytest.raises(RenderError, match="must have a whole number of pixels"):
            render(tracker, 0, long_side=wrong)

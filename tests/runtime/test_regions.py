"""Points in a mask, a polygon or a box."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from decomo_runtime import ModelFacts, QueryError
from decomo_runtime.queries import check_queries
from decomo_runtime.regions import box_mask, queries_in, region_queries

HEIGHT, WIDTH = 40, 48
MODEL = ModelFacts("clip", num_frames=6, height=HEIGHT, width=WIDTH, fps=24.0, preset="cpu", occlusion_threshold=0.5)
mask_queries, polygon_queries, box_queries = (
    partial(queries_in, option) for option in ("--mask", "--polygon", "--box")
)


def mask_file(path: Path, *pixels: tuple[int, int], value: int = 255, size: tuple[int, int] = (HEIGHT, WIDTH)) -> Path:
    """An image, black but for `pixels` (x, y)."""
    image = np.zeros(size, np.uint8)
    for x, y in pixels:
        image[y, x] = value
    assert cv2.imwrite(str(path), image)
    return path


@pytest.mark.parametrize("value", [1, 255])
def test_a_mask_s_pixels_are_followed(tmp_path: Path, value: int):
    """At a spacing of 1 all pixels of it, in the middle of each."""
    pixels = [(5, 3), (6, 3), (6, 4), (47, 39)]
    path = mask_file(tmp_path / "dog@home.png", *pixels, value=value)
    queries = mask_queries(f"{path}@4", 1.0, MODEL)
    assert queries.tolist() == [[4, x, y] for x, y in pixels]


def test_a_jpeg_s_ringing_is_no_mask(tmp_path: Path):
    image = np.zeros((HEIGHT, WIDTH), np.uint8)
    image[10:20, 11:31] = 255
    cv2.imwrite(str(tmp_path / "m.jpg"), image, [cv2.IMWRITE_JPEG_QUALITY, 60])
    _, x, y = mask_queries(f"{tmp_path / 'm.jpg'}@0", 1.0, MODEL).T
    assert (x.min(), x.max(), y.min(), y.max()) == (11, 30, 10, 19)


def test_a_cut_out_is_where_it_is_not_transparent(tmp_path: Path):
    image = np.full((HEIGHT, WIDTH, 4), 200, np.uint8)  # as programs keep the colours beneath
    image[10, 11, :3] = 0  # of the object, and black
    image[..., 3] = 0
    image[10:12, 11:14, 3] = 255
    cv2.imwrite(str(tmp_path / "m.png"), image)
    queries = mask_queries(f"{tmp_path / 'm.png'}@0", 1.0, MODEL)
    assert queries[:, 1:].tolist() == [[x, y] for y in (10, 11) for x in (11, 12, 13)]
    image[..., 3] = 0
    cv2.imwrite(str(tmp_path / "m.png"), image)
    with pytest.raises(QueryError, match="is black"):
        mask_queries(f"{tmp_path / 'm.png'}@0", 1.0, MODEL)


def test_an_opaque_mask_is_where_it_is_not_black(tmp_path: Path):
    image = np.zeros((HEIGHT, WIDTH, 4), np.uint8)
    image[..., 3] = 255
    image[10, 11, 1] = 9
    cv2.imwrite(str(tmp_path / "m.png"), image)
    assert mask_queries(f"{tmp_path / 'm.png'}@0", 1.0, MODEL).tolist() == [[0, 11, 10]]


def test_spacing_from_the_middle_of_the_region():
    """Of columns 10 to 19 and rows 4 to 6, points 4 apart: 10.5, 14.5 and 18.5 have 0.5 beyond on either side."""
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[4:7, 10:20] = True
    assert region_queries(mask, 2, 4.0).tolist() == [[2, x, 5] for x in (10.5, 14.5, 18.5)]
    assert len(region_queries(np.ones((HEIGHT, WIDTH), bool), 0)) == (HEIGHT // 8) * (WIDTH // 8)  # every 8 pixels


def test_a_ring_that_no_point_of_the_grid_meets_has_one():
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[2:30, 3:40] = True
    mask[5:27, 6:37] = False
    ((t, x, y),) = region_queries(mask, 1, 100.0)
    assert t == 1
    assert mask[int(y), int(x)]
    assert cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5)[int(y), int(x)] >= 2  # in its middle


@given(st.data())
def test_points_lie_in_the_region(data: st.DataObject):
    height, width = data.draw(st.integers(1, 30)), data.draw(st.integers(1, 30))
    mask = np.random.default_rng(data.draw(st.integers(0, 99))).random((height, width)) < 0.3
    mask[data.draw(st.integers(0, height - 1)), data.draw(st.integers(0, width - 1))] = True
    queries = region_queries(mask, 0, data.draw(st.floats(1, 40)))
    model = ModelFacts("clip", 1, height, width, 24.0, "cpu", 0.5)
    x, y = np.floor(check_queries(queries, model)[:, 1:] + 0.5).astype(int).T
    assert len(queries) > 0
    assert mask[y, x].all()


def test_a_polygon_s_pixels():
    """A right-angled triangle, its corners included."""
    queries = polygon_queries("4,6,14,6,4,16@3", 1.0, MODEL)
    expected = [[3, x, y] for y in range(6, 17) for x in range(4, 21 - y)]
    assert queries.tolist() == expected


def test_of_a_polygon_what_lies_in_the_frame():
    _, x, y = polygon_queries("-20,-20,9,-20,9,7,-20,7@0", 1.0, MODEL).T
    assert (x.min(), x.max(), y.min(), y.max()) == (0, 9, 0, 7)


@pytest.mark.parametrize(
    ("text", "columns", "rows"),
    [
        ("10,20,3,2@5", range(10, 13), range(20, 22)),
        ("9.5,19.6,3,2@5", range(9, 12), range(20, 22)),
        ("-4,38,6,50@5", range(2), range(38, 40)),
        ("0,0,48,40@5", range(48), range(40)),
    ],
)
def test_a_box_s_pixels(text: str, columns: range, rows: range):
    assert box_queries(text, 1.0, MODEL).tolist() == [[5, x, y] for y in rows for x in columns]


def test_a_box_holds_the_pixels_whose_centres_lie_in_it():
    """On its left and upper side they belong to it, so that boxes side by side share none."""
    left, right = (box_mask(np.array([[x, 1.5], [x + 3, 4]]), (6, 9)) for x in (1.0, 4.0))
    assert np.argwhere(left).tolist() == [[y, x] for y in (2, 3) for x in (1, 2, 3)]
    assert np.argwhere(right).tolist() == [[y, x] for y in (2, 3) for x in (4, 5, 6)]
    assert not box_mask(np.array([[2.1, 1], [2.9, 4]]), (6, 9)).any()


@pytest.mark.parametrize(
    ("read", "text", "reason"),
    [
        (mask_queries, "{dog}", "is not PNG@T"),
        (mask_queries, "{dog}@", "is not PNG@T"),
        (mask_queries, "@3", "is not PNG@T"),
        (mask_queries, "{dog}@-1", "is not PNG@T"),
        (mask_queries, "{dog}@6", "the frame must be within 0 .. 5"),
        (mask_queries, "no.png@0", "--mask no.png cannot be read (No such file or directory)"),
        (mask_queries, "{folder}@0", "cannot be read (Is a directory)"),
        (mask_queries, "{text}@0", "does not decode as an image"),
        (mask_queries, "{small}@0", "is 20x10 but the clip is 48x40; resize it"),
        (mask_queries, "{black}@0", "is black: no pixel of it is the object's"),
        (polygon_queries, "1,2,3,4@0", "is not X,Y,X,Y,X,Y@T: three corners or more"),
        (polygon_queries, "1,2,3,4,5,6,7@0", "is not X,Y,X,Y,X,Y@T"),
        (polygon_queries, "1,2,3,4,5,x@0", "is not X,Y,X,Y,X,Y@T"),
        (polygon_queries, "1,2,3,4,5,nan@0", "is not X,Y,X,Y,X,Y@T"),
        (polygon_queries, "1,2,3,4,5,1e9@0", "is not X,Y,X,Y,X,Y@T"),
        (polygon_queries, "1,2,30,4,5,60", "is not X,Y,X,Y,X,Y@T"),
        (polygon_queries, "1,2,30,4,5,60@9", "the frame must be within 0 .. 5"),
        (polygon_queries, "50,2,70,4,55,30@0", "lies outside of the frame"),
        (polygon_queries, "5,-2,7,-4,5,-30@0", "lies outside of the frame"),
        (box_queries, "1,2,3@0", "is not X,Y,WIDTH,HEIGHT@T"),
        (box_queries, "1,2,0,4@0", "a size above 0"),
        (box_queries, "1,2,nan,4@0", "a size above 0"),
        (box_queries, "1,2,3,4@1.5", "is not X,Y,WIDTH,HEIGHT@T"),
        (box_queries, "48,2,3,4@0", "lies outside of the frame"),
        (box_queries, "4.6,2,0.2,4@0", "or between its pixels"),
        (box_queries, "1,2,3,4@6", "the frame must be within 0 .. 5"),
    ],
)
def test_bad_regions(tmp_path: Path, read: Callable[..., np.ndarray], text: str, reason: str):
    (tmp_path / "text.png").write_text("no image")
    files = {
        "dog": mask_file(tmp_path / "dog.png", (3, 4)),
        "small": mask_file(tmp_path / "small.png", (3, 4), size=(10, 20)),
        "black": mask_file(tmp_path / "black.png"),
        "text": tmp_path / "text.png",
        "folder": tmp_path,
    }
    with pytest.raises(QueryError, match=re.escape(reason)):
        read(text.format(**files), None, MODEL)


@pytest.mark.parametrize("spacing", [0, 0.5, -3, float("nan"), float("inf")])
def test_bad_spacing(spacing: float):
    with pytest.raises(QueryError, match="must be at least 1 pixel"):
        box_queries("1,2,9,9@0", spacing, MODEL)


def test_a_mask_of_nothing_has_no_points():
    with pytest.raises(QueryError, match="the region has no pixel"):
        region_queries(np.zeros((5, 7), bool), 0)

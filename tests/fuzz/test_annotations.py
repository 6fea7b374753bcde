"""Whatever a file of annotations holds, it is an annotation of the clip or one sentence."""

from __future__ import annotations

import json
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from decomo_runtime import AnnotationError
from decomo_runtime.propagation.formats import registry
from decomo_runtime.propagation.formats.asked import ClipFacts
from decomo_runtime.propagation.shapes import Kind
from decomotion.images import png
from near_misses import answer, any_or_near, near_tree

HEIGHT, WIDTH = 28, 40
CLIP = ClipFacts((HEIGHT, WIDTH), 8, "sliding", [f"{frame:05d}.jpg" for frame in range(8)])
CORNERS = [[2, 10], [14, 10], [14, 22]]
COCO = {
    "images": [{"id": 7, "file_name": "00003.jpg", "width": WIDTH, "height": HEIGHT}],
    "annotations": [
        {"id": 1, "image_id": 7, "category_id": 3, "track_id": 1, "segmentation": [[2, 10, 14, 10, 14, 22]]},
        {
            "id": 2,
            "image_id": 7,
            "category_id": 3,
            "track_id": 2,
            "segmentation": {"size": [HEIGHT, WIDTH], "counts": "dd0l0<N"},
        },
        {"id": 3, "image_id": 7, "category_id": 3, "track_id": 3, "bbox": [3, 4, 10, 8], "keypoints": [5, 6, 2]},
    ],
    "categories": [{"id": 3, "name": "mouse", "keypoints": ["nose"]}],
}
LABELME = {
    "imagePath": "00003.jpg",
    "imageWidth": WIDTH,
    "imageHeight": HEIGHT,
    "shapes": [
        {"label": "a", "points": CORNERS, "shape_type": "polygon", "group_id": 1},
        {"label": "b", "points": CORNERS[:2], "shape_type": "mask", "mask": "iVBORw0KGgo="},
    ],
}
STUDIO = [
    {
        "data": {"image": "/data/00003.jpg"},
        "annotations": [{"result": [{"type": "polygonlabels", "value": {"points": CORNERS, "polygonlabels": ["a"]}}]}],
    }
]
CVAT = b"""<annotations><track id="1" label="a"><polygon frame="1" points="2,3;14,3;14,20"/></track><track id="2">
<mask frame="0" rle="1, 2, 3" left="3" top="2" width="3" height="2"/><box frame="3" xtl="1" ytl="2" xbr="9" ybr="8"/>
</track></annotations>"""
LABELS = png(np.pad(np.full((9, 9), 3, np.uint8), ((5, 14), (8, 23))))


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("annotations")


def check(path: Path, content: bytes, frame: int | None = None) -> None:
    path.write_bytes(content)
    found = answer(lambda: registry.read([(path, frame)], CLIP), AnnotationError)
    for shape in found[0].shapes if found else ():
        assert 0 <= shape.thing < len(found[0].things)
        if shape.kind.is_region:
            assert shape.mask is not None
            assert shape.mask.shape == CLIP.size
            assert shape.mask.any()
        else:
            assert shape.xy.shape[1:] == (2,)
            assert shape.kind == Kind.POINTS or shape.xy.shape == (2, 2)


@given(tree=near_tree(COCO) | near_tree(LABELME) | near_tree(STUDIO), frame=st.sampled_from([None, 0]))
def test_json(place: Path, tree: object, frame: int | None):
    check(place / "a.json", json.dumps(tree).encode(), frame)


@given(content=any_or_near(json.dumps(LABELME).encode()))
def test_bytes_of_json(place: Path, content: bytes):
    check(place / "a.json", content)


@given(content=any_or_near(CVAT))
def test_cvat(place: Path, content: bytes):
    check(place / "a.xml", content)


@given(content=any_or_near(LABELS, PALETTE := LABELS[:25] + b"\x03" + LABELS[26:]))
def test_labels(place: Path, content: bytes):
    check(place / "a.png", content, 0)


def test_a_palette_png_that_only_says_to_be_huge(place: Path):
    head = b"IHDR" + (30_000).to_bytes(4, "big") * 2 + b"\x08\x03\x00\x00\x00"
    chunk = (13).to_bytes(4, "big") + head + zlib.crc32(head).to_bytes(4, "big")
    check(place / "a.png", b"\x89PNG\r\n\x1a\n" + chunk, 0)

"""Whatever a file of keypoints holds, it is keypoints or one sentence."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from consumers import consumer
from decomo_runtime import QueryError
from decomo_runtime.keypoints import Keypoints, read_keypoints
from near_misses import answer, any_array, any_or_near, near_tree, plain_tree

PREDICTIONS = b"""\
scorer,net,net,net,net,net,net
bodyparts,nose,nose,nose,tail,tail,tail
coords,x,y,likelihood,x,y,likelihood
0,10.5,20.25,0.7,,,
1,11.5,21.25,0.95,300.0,180.5,0.2
"""
LABELS = b"""\
scorer,,,Me,Me
bodyparts,,,nose,nose
coords,,,x,y
labeled-data,mouse,img0012.png,12.5,22.25
"""
COCO = {
    "images": [{"id": 7, "file_name": "b1.png", "frame_id": 4}, {"id": 8, "file_name": "b0.png", "frame_id": 2}],
    "annotations": [
        {"id": 1, "image_id": 7, "category_id": 3, "track_id": 1, "keypoints": [10.5, 20, 2, 300, 180, 1]},
        {"id": 2, "image_id": 8, "category_id": 3, "track_id": 1, "keypoints": [0, 0, 0, 301, 181, 2]},
    ],
    "categories": [{"id": 3, "name": "mouse", "keypoints": ["nose", "tail"]}],
}


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("keypoints")


def check(path: Path) -> None:
    keypoints = answer(lambda: read_keypoints(path), QueryError)
    if keypoints is not None:
        shape = len(keypoints.names), len(keypoints.frames)
        assert keypoints.xy.shape == (*shape, 2)
        assert keypoints.score.shape == shape
        assert (np.diff(keypoints.frames) > 0).all()
        answer(lambda: keypoints.queries(), QueryError)


@given(content=any_or_near(PREDICTIONS, LABELS))
def test_csv_of_deeplabcut(place: Path, content: bytes):
    (place / "a.csv").write_bytes(content)
    check(place / "a.csv")


@given(content=any_or_near(json.dumps(COCO).encode()) | near_tree(COCO).map(lambda tree: json.dumps(tree).encode()))
def test_coco(place: Path, content: bytes):
    (place / "a.json").write_bytes(content)
    check(place / "a.json")


NAMES = b"(lp0\n(I1\n(lp1\n(Vnet\nVnose\nVx\ntp2\na(Vnet\nVnose\nVy\ntp3\natp4\na."
"""pandas' names of two columns, as it pickles them."""


@pytest.fixture(scope="module")
def h5(place: Path) -> Any:
    """Bytes of HDF5 itself are its library's; what its attributes and arrays hold is ours to look at."""
    h5py = consumer("h5py")

    def write(attributes: dict[str, Any], arrays: dict[str, Any]) -> Path:
        with h5py.File(place / "a.h5", "w") as file:
            group = file.create_group("df_with_missing")
            for name, value in attributes.items():
                group.attrs[name] = value
            for name, value in arrays.items():
                group[name] = value
        return place / "a.h5"

    return write


def test_whole_h5(h5: Any):
    rows = np.zeros(3, [("index", "i8"), ("values_block_0", "f8", (2,))])
    rows["index"] = 4, 2, 3
    path = h5({"pandas_type": "frame_table", "non_index_axes": np.bytes_(NAMES)}, {"table": rows})
    assert read_keypoints(path).frames.tolist() == [2, 3, 4]


@given(names=any_or_near(NAMES), rows=any_array())
def test_h5_of_deeplabcut(h5: Any, names: bytes, rows: np.ndarray):
    try:
        path = h5({"pandas_type": "frame_table", "non_index_axes": np.void(names or b"0")}, {"table": rows})
    except (TypeError, ValueError):  # no array that HDF5 holds
        return
    check(path)


@given(levels=st.lists(any_array(), max_size=6), values=any_array(), blocks=plain_tree())
def test_fixed_h5_of_deeplabcut(h5: Any, levels: list[np.ndarray], values: np.ndarray, blocks: Any):
    names = [f"axis{axis}_{kind}{level}" for axis, level in ((0, 0), (0, 1), (1, 0)) for kind in ("level", "label")]
    arrays = dict(zip(names, levels, strict=False)) | {"block0_values": values, "axis1": values}
    try:
        path = h5({"pandas_type": "frame", "nblocks": 1 if blocks is None else blocks}, arrays)
    except (TypeError, ValueError):
        return
    check(path)


@pytest.mark.parametrize("content", [b"", b"\x89HDF\r\n\x1a\n", b"\x89HDF\r\n\x1a\n" + bytes(2000)])
def test_what_is_no_h5(place: Path, content: bytes):
    consumer("h5py")
    (place / "b.h5").write_bytes(content)
    assert answer(lambda: read_keypoints(place / "b.h5"), QueryError) is None


def test_h5_that_only_says_to_be_huge(place: Path):
    h5py: Any = consumer("h5py")
    with h5py.File(place / "huge.h5", "w") as file:
        group = file.create_group("df_with_missing")
        group.attrs["pandas_type"] = "frame_table"
        group.attrs["non_index_axes"] = b"(lp0\n(I1\n(lp1\ntp2\na."
        group.create_dataset("table", (10**12,), [("index", "i8"), ("values_block_0", "f8", (3,))], chunks=(10,))
    assert answer(lambda: read_keypoints(place / "huge.h5"), QueryError) is None


def test_coco_that_takes_all_memory(place: Path):
    number = 20_000
    images = [{"id": each, "frame_id": each} for each in range(number)]
    annotations = [
        {"image_id": each, "category_id": 0, "track_id": each, "keypoints": [1, 1, 2]} for each in range(number)
    ]
    content = {"images": images, "annotations": annotations, "categories": [{"id": 0}]}
    (place / "huge.json").write_text(json.dumps(content))
    assert answer(lambda: read_keypoints(place / "huge.json"), QueryError) is None


def test_whole_files_are_read(place: Path):
    (place / "a.csv").write_bytes(PREDICTIONS)
    (place / "a.json").write_text(json.dumps(COCO))
    for name in ("a.csv", "a.json"):
        assert isinstance(read_keypoints(place / name), Keypoints)

"""PointOdyssey, EgoPoints, Dynamic Replica, BADJA: whatever a file of theirs holds, it is a video or one sentence."""

from __future__ import annotations

import gzip
import json
import pickle
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import dataset_files
from decomo_eval.dataset import read_dataset
from decomo_eval.errors import DatasetError
from decomo_eval.safe_torch import load_tensors
from decomo_eval.video import Video
from near_misses import EXTREMES, answer, any_or_near, forged_npy, forged_zip, near_arrays, near_tree, npy, npz


def check(root: Path) -> None:
    """Reads all videos and has them answered truly."""
    videos: Mapping[str, Video] | None = answer(lambda: read_dataset(root), DatasetError)
    for name in videos or ():
        video = answer(lambda name=name: videos[name] if videos else None, DatasetError)
        if video is None:
            continue
        assert video.points.shape == (*video.occluded.shape, 2)
        assert np.isfinite(video.points).all()
        assert video.judged is None or (video.judged.shape, video.judged.dtype) == (video.occluded.shape, bool)
        assert (~video.occluded).any(axis=1).all()
        figures = video.figures
        assert figures is not None
        told = answer(lambda v=video, f=figures: f(v.points * 256, v.occluded), DatasetError)
        assert told is None or all(isinstance(value, float) for value in told.values())


NAMES = (
    *(("torch._utils", "_rebuild_tensor_v2"), ("torch", "FloatStorage"), ("torch", "BoolStorage")),
    *(("torch", "Size"), ("collections", "OrderedDict"), ("near_misses", "detonate")),
)
PARTS = (
    *(pickle.NONE, pickle.NEWTRUE, pickle.MARK, pickle.EMPTY_DICT, pickle.EMPTY_LIST, pickle.EMPTY_TUPLE),
    *(pickle.REDUCE, pickle.BUILD, pickle.TUPLE, pickle.TUPLE1, pickle.TUPLE2, pickle.TUPLE3, pickle.BINPERSID),
    *(pickle.APPEND, pickle.SETITEM, pickle.SETITEMS, pickle.DUP, pickle.POP, pickle.STOP, pickle.NEWOBJ, pickle.OBJ),
    *(pickle.GLOBAL + f"{module}\n{name}\n".encode() for module, name in NAMES),
    *(pickle.UNICODE + text.encode() + b"\n" for text in ("storage", "0", "cpu", "traj_2d", "verts_inds_vis")),
    *(pickle.INT + f"{value}\n".encode() for value in EXTREMES),
    *(pickle.BINGET + bytes([place]) for place in range(8)),
)


@st.composite
def programs(draw: st.DrawFn, whole: bytes) -> bytes:
    """A pickle of tensors with any sequence of instructions in the middle, or in the place of some of its bytes."""
    parts = b"".join(draw(st.lists(st.sampled_from(PARTS), min_size=1, max_size=9)))
    begin = draw(st.integers(2, len(whole)))
    return whole[:begin] + parts + whole[draw(st.integers(begin, len(whole))) :]


def archives(arrays: Mapping[str, Any]) -> st.SearchStrategy[bytes]:
    members = [(f"{key}.npy", npy(array)) for key, array in arrays.items()]
    return any_or_near(npz(arrays)) | near_arrays(arrays).map(npz) | forged_zip(members, forged_npy())


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Path, Any]]:
    """A folder of each dataset, and its arrays."""
    names = ("pointodyssey", "egopoints", "dynamic_replica", "badja")
    roots = {name: tmp_path_factory.mktemp(name) for name in names}
    return {name: (root, getattr(dataset_files, f"write_{name}")(root)) for name, root in roots.items()}


Written = dict[str, tuple[Path, Any]]


@given(data=st.data())
def test_pointodyssey(written: Written, data: st.DataObject):
    root, arrays = written["pointodyssey"]
    first = {"trajs_2d": arrays["trajs_2d"], "visibilities": arrays["visibs"].astype(np.uint8)}
    (root / "r5_new_f" / "anno.npz").write_bytes(data.draw(archives(arrays) | archives(first)))
    check(root)


@given(data=st.data())
def test_egopoints(written: Written, data: st.DataObject):
    root, arrays = written["egopoints"]
    next(root.glob("*/annot.npz")).write_bytes(data.draw(archives(arrays)))
    check(root)


@given(data=st.data())
def test_dynamic_replica_s_annotations(written: Written, data: st.DataObject):
    root, _ = written["dynamic_replica"]
    file, kept = root / "frame_annotations_valid.jgz", root / "kept"
    if not kept.exists():
        kept.write_bytes(file.read_bytes())
    entries = json.loads(gzip.decompress(kept.read_bytes()))[:4]
    trees = near_tree(entries).map(lambda tree: gzip.compress(json.dumps(tree).encode()))
    file.write_bytes(data.draw(any_or_near(gzip.compress(json.dumps(entries).encode())) | trees))
    check(root)
    file.write_bytes(kept.read_bytes())


@given(data=st.data())
def test_dynamic_replica_s_tensors(written: Written, data: st.DataObject):
    root, _ = written["dynamic_replica"]
    files = sorted(root.glob("*_left/trajectories/*.pth"))
    with zipfile.ZipFile(files[1]) as archive:
        members = [(name, archive.read(name)) for name in archive.namelist()]
    program = next(content for name, content in members if name.endswith("data.pkl"))
    content = data.draw(any_or_near(files[1].read_bytes()) | forged_zip(members, programs(program)))
    kept = files[0].read_bytes()
    files[0].write_bytes(content)
    answer(lambda: load_tensors(files[0], ("traj_2d", "verts_inds_vis")), DatasetError)
    check(root)
    files[0].write_bytes(kept)


@given(data=st.data())
def test_badja(written: Written, data: st.DataObject):
    root, _ = written["badja"]
    file, kept = root / "joint_annotations" / "horsejump-high.json", root / "kept"
    if not kept.exists():
        kept.write_bytes(file.read_bytes())
    entries = json.loads(kept.read_bytes())
    content = data.draw(any_or_near(kept.read_bytes()) | near_tree(entries).map(lambda tree: json.dumps(tree).encode()))
    file.write_bytes(content)
    check(root)

"""TAP-Vid's pickles: damaged ones, and programs that were written to harm."""

from __future__ import annotations

import pickle
import resource
import struct
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from decomo_eval import safe_pickle
from decomo_eval.dataset import Video, read_dataset
from decomo_eval.errors import DatasetError
from decomotion.images import jpeg, png
from near_misses import EXTREMES, answer, any_array, any_or_near, near_arrays

FRAMES, HEIGHT, WIDTH, POINTS = 3, 6, 9, 2
VIDEO = np.random.default_rng(0).integers(0, 256, (FRAMES, HEIGHT, WIDTH, 3), np.uint8)
ENTRY = {
    "video": VIDEO,
    "points": np.linspace(0.1, 0.9, POINTS * FRAMES * 2).reshape(POINTS, FRAMES, 2),
    "occluded": np.zeros((POINTS, FRAMES), bool),
}
PNGS = [png(frame) for frame in VIDEO]
STRIP = jpeg(VIDEO[0, :3], 90)
"""A picture of another size."""
ENCODED = {**ENTRY, "video": PNGS}
PROGRAMS = [pickle.dumps({"goat": entry}, protocol) for entry in (ENTRY, ENCODED) for protocol in (2, 4, 5)]


def short(text: str) -> bytes:
    return pickle.SHORT_BINUNICODE + bytes([len(text)]) + text.encode()


NAMES = (
    *(("numpy", "ndarray"), ("numpy", "dtype"), ("_codecs", "encode"), ("__builtin__", "bytes")),
    *(
        ("collections", "OrderedDict"),
        ("numpy._core.multiarray", "_reconstruct"),
        ("a\nb", "c\nd"),
    ),
    *(("numpy._core.multiarray", "scalar"), ("numpy._core.numeric", "_frombuffer"), ("numpy", "memmap")),
    ("near_misses", "detonate"),
)
PARTS = (
    *(pickle.NONE, pickle.NEWTRUE, pickle.MARK, pickle.EMPTY_DICT, pickle.EMPTY_LIST, pickle.EMPTY_TUPLE),
    *(pickle.EMPTY_SET, pickle.REDUCE, pickle.BUILD, pickle.TUPLE, pickle.TUPLE1, pickle.TUPLE2, pickle.TUPLE3),
    *(pickle.APPEND, pickle.APPENDS, pickle.SETITEM, pickle.SETITEMS, pickle.ADDITEMS, pickle.FROZENSET),
    *(pickle.MEMOIZE, pickle.DUP, pickle.POP, pickle.POP_MARK, pickle.STOP, pickle.NEWOBJ, pickle.NEWOBJ_EX),
    *(pickle.OBJ, pickle.LIST, pickle.DICT, pickle.BINPERSID, pickle.NEXT_BUFFER, pickle.READONLY_BUFFER),
    *(pickle.STACK_GLOBAL, pickle.EXT1 + b"\x01", pickle.BINGET + b"\x00", pickle.BINGET + b"\x01"),
    *(pickle.INST + b"near_misses\ndetonate\n", pickle.GLOBAL + b"near_misses\ndetonate\n", pickle.TUPLE1 * 200_000),
    *(pickle.GLOBAL + "\n".join(name).encode() + b"\n" for name in NAMES),
    *(short(module) + short(name) + pickle.STACK_GLOBAL for module, name in NAMES),
    *(pickle.LONG_BINPUT + struct.pack("<I", value % 2**32) for value in EXTREMES),
    *(pickle.LONG_BINGET + struct.pack("<I", value % 2**32) for value in EXTREMES),
    *(pickle.BININT + struct.pack("<I", value % 2**32) for value in EXTREMES),
    *(form + struct.pack("<Q", 10 << 30) for form in (pickle.FRAME, pickle.BINBYTES8, pickle.BYTEARRAY8)),
    *(pickle.LONG4 + struct.pack("<i", value) for value in (-1, 2**31 - 1)),
    *(map(short, ("video", "points", "occluded", "f8", "u1", "O8", "V8", "U9", "S3", "<", "latin1", "C", "a\nb"))),
    *(pickle.SHORT_BINBYTES + bytes([8]) + bytes(8), pickle.BINFLOAT + b"\x7f\xf8" + bytes(6), pickle.INT + b"9\n"),
)


@st.composite
def programs(draw: st.DrawFn) -> bytes:
    """Any sequence of a pickle's instructions, alone or in the middle of a whole pickle."""
    parts = b"".join(draw(st.lists(st.sampled_from(PARTS), min_size=1, max_size=12)))
    if draw(st.booleans()):
        return pickle.PROTO + b"\x04" + parts + pickle.STOP
    whole = draw(st.sampled_from(PROGRAMS))
    place = draw(st.integers(2, len(whole)))
    return whole[:place] + parts + whole[place:]


def check_videos(path: Path) -> None:
    videos = answer(lambda: read_dataset(path), DatasetError)
    for name in videos or ():
        video = answer(lambda name=name: videos[name] if videos else None, DatasetError)
        if video is not None:
            check_video(video)


def check_video(video: Video) -> None:
    frames = answer(video.frames, DatasetError)
    if frames is not None:
        assert frames.shape == (video.num_frames, video.height, video.width, 3)
        assert frames.dtype == np.uint8
    assert video.points.shape == (*video.occluded.shape, 2)
    assert video.points.dtype == np.float64
    assert video.occluded.dtype == bool
    assert np.isfinite(video.points[~video.occluded]).all()


DEEP = pickle.NONE + pickle.TUPLE1 * 250_000


@pytest.mark.parametrize(
    "program",
    [
        pickle.EMPTY_DICT + DEEP + pickle.NONE + pickle.SETITEM,
        pickle.EMPTY_DICT + pickle.MARK + DEEP + pickle.NONE + pickle.SETITEMS,
        pickle.MARK + DEEP + pickle.NONE + pickle.DICT,
        pickle.EMPTY_SET + pickle.MARK + DEEP + pickle.ADDITEMS,
        pickle.MARK + DEEP + pickle.FROZENSET,
    ],
)
def test_deep_keys_are_refused(place: Path, program: bytes):
    """Python hashes tuples within tuples by recursion that it does not bound."""
    (place / "a.pkl").write_bytes(pickle.PROTO + b"\x04" + program + pickle.STOP)
    assert answer(lambda: safe_pickle.load(place / "a.pkl"), DatasetError) is None


@pytest.mark.parametrize(
    "program",
    [
        pickle.NONE + pickle.LONG_BINPUT + struct.pack("<I", 2**31 - 1),
        pickle.BYTEARRAY8 + struct.pack("<Q", 2**32) + bytes(1000),
        pickle.BINBYTES8 + struct.pack("<Q", 2**32) + bytes(1000),
        pickle.FRAME + struct.pack("<Q", 2**32) + pickle.NONE,
    ],
)
def test_a_number_takes_no_memory(place: Path, program: bytes):
    """However many things, or bytes, it says that there are."""
    (place / "a.pkl").write_bytes(pickle.PROTO + b"\x05" + program + pickle.STOP)
    begin = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with suppress(DatasetError):
        safe_pickle.load(place / "a.pkl")
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < begin + 2**18  # 256 MiB, in KiB


@given(content=st.one_of(any_or_near(*PROGRAMS), programs()))
def test_programs(place: Path, content: bytes):
    (place / "a.pkl").write_bytes(content)
    answer(lambda: safe_pickle.load(place / "a.pkl"), DatasetError)
    check_videos(place / "a.pkl")


def lists(depth: int, width: int, leaf: Any) -> Any:
    """A list of so many references to one list of so many, and so on: small in a pickle, large as an array."""
    for _ in range(depth):
        leaf = [leaf] * width
    return leaf


def tuples(depth: int) -> Any:
    nested: Any = ()
    for _ in range(depth):
        nested = (nested,)
    return nested


@st.composite
def near_entries(draw: st.DrawFn) -> Any:
    """A video whose values are of other kinds than TAP-Vid's."""
    entry: dict[Any, Any] = dict(draw(near_arrays(ENTRY)))
    stored = [
        *(PNGS, np.array(PNGS), tuple(PNGS), PNGS[:1], [*PNGS[:2], STRIP], ["a"] * FRAMES, [b""] * FRAMES),
        *([PNGS[0]] * 1000, b"abc", None, {0: PNGS}, lists(30, 2, b""), PNGS[0]),
    ]
    values = st.one_of(
        any_array(),
        st.sampled_from([None, "here", lists(25, 2, 0.5), lists(70, 1, 0), tuples(90), [[0.5] * 3] * 2, {"a": 1}, -1]),
    )
    if draw(st.booleans()):
        entry["video"] = draw(st.sampled_from(stored))
    if draw(st.integers(0, 3)) == 0:
        entry[draw(st.sampled_from(("points", "occluded", "video")))] = draw(values)
    return entry if draw(st.integers(0, 9)) else draw(values)


@pytest.mark.parametrize(
    "changes",
    [
        {"points": lists(25, 2, 0.5)},
        {"points": ENTRY["points"] + 1j},
        {"points": ENTRY["points"].astype("U9")},
        {"occluded": ENTRY["occluded"].tolist()},
    ],
)
def test_only_arrays_of_numbers_are_tracks(place: Path, changes: Any):
    """Lists in a pickle may hold one another over and over: few bytes, and gigabytes as an array."""
    (place / "a.pkl").write_bytes(pickle.dumps({"goat": {**ENTRY, **changes}}))
    with pytest.raises(DatasetError, match="must have an array of numbers as"):
        dict(read_dataset(place / "a.pkl"))


@pytest.mark.parametrize("name", [None, b"goat", 0.5, tuples(60)])
def test_videos_are_named_by_text(place: Path, name: Any):
    (place / "a.pkl").write_bytes(pickle.dumps({name: ENTRY}))
    assert answer(lambda: dict(read_dataset(place / "a.pkl")), DatasetError) is None


NAMED = st.sampled_from(["goat", "", "a/../b", "a\nb", 3, -1.5, None, b"goat", ("a", "b"), tuples(60), np.int64(2)])


@given(
    content=st.one_of(
        st.dictionaries(NAMED, near_entries(), max_size=2), st.lists(near_entries(), max_size=2), near_entries()
    ).map(pickle.dumps)
)
def test_entries(place: Path, content: bytes):
    (place / "a.pkl").write_bytes(content)
    check_videos(place / "a.pkl")
    shards = place / "shards"
    shards.mkdir(exist_ok=True)
    (shards / "0.pkl").write_bytes(content)
    check_videos(shards)

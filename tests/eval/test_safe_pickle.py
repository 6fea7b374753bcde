"""Arrays and containers come through, code does not run."""

from __future__ import annotations

import os
import pickle
import re
import struct
from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from decomo_eval import safe_pickle
from decomo_eval.errors import DatasetError, UnsafePickleError

ARRAYS = {
    "frames": np.arange(24, dtype=np.uint8).reshape(2, 2, 2, 3),
    "points": np.linspace(0, 1, 12).reshape(2, 3, 2),
    "float32": np.array([1.5, -2], np.float32),
    "big_endian": np.arange(3, dtype=">i4"),
    "fortran": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
    "not_contiguous": np.arange(12).reshape(3, 4)[:, ::2],
    "bool": np.array([[True, False]]),
    "empty": np.zeros((0, 5, 2)),
    "no_axes": np.array(3.0),
    "words": np.array(["ab", "c"]),
    "bytes": np.array([b"ab", b"c"]),
}


@pytest.fixture
def load(tmp_path: Path) -> Any:
    def load(content: bytes) -> Any:
        path = tmp_path / "content.pkl"
        path.write_bytes(content)
        return safe_pickle.load(path)

    return load


def under_numpy_1(content: bytes) -> bytes:
    """The same pickle with the module names of numpy 1: `numpy._core` is one letter longer than `numpy.core`."""
    assert b"numpy._core" in content
    content = re.sub(
        rb"\x8c(.)numpy\._core([a-z.]*)",  # SHORT_BINUNICODE, one byte of length (protocol 4 and 5)
        lambda found: b"\x8c" + bytes([found[1][0] - 1]) + b"numpy.core" + found[2],
        content,
        flags=re.DOTALL,
    )
    content = content.replace(b"cnumpy._core", b"cnumpy.core")  # GLOBAL, ended by a newline (up to protocol 3)
    # The frame is now shorter than it says: take the frames out (FRAME, eight bytes of length).
    return re.sub(rb"\x95.{8}", b"", content, count=1, flags=re.DOTALL)


@pytest.mark.parametrize("protocol", [2, 3, 4, 5])
@pytest.mark.parametrize("numpy_version", [1, 2])
@pytest.mark.parametrize("name", ARRAYS)
def test_arrays_come_back(load: Any, name: str, protocol: int, numpy_version: int) -> None:
    content = pickle.dumps({"array": ARRAYS[name], "again": [ARRAYS[name]]}, protocol=protocol)
    expected = pickle.loads(content)["array"]  # numpy brings some arrays to native byte order
    if np.lib.NumpyVersion(np.__version__) >= "2.0.0" and numpy_version == 1:
        content = under_numpy_1(content)
    loaded = load(content)
    assert loaded["array"] is loaded["again"][0]
    np.testing.assert_array_equal(np.asarray(loaded["array"]), expected, strict=True)


@pytest.mark.parametrize("protocol", [2, 3, 4, 5])
def test_scalars_and_plain_containers_come_back(load: Any, protocol: int) -> None:
    content = {
        "goat": [b"\xff\xd8jpeg", b"", (1, 2.5, None, True)],
        3: {"float": np.float32(2.5), "int": np.int64(-3), "bool": np.bool_(True)},
    }
    assert load(pickle.dumps(content, protocol=protocol)) == content
    assert load(pickle.dumps(OrderedDict(b=1, a=2), protocol=protocol)) == {"b": 1, "a": 2}


class Payload:
    """Pickled, it asks for `function(*arguments)` when it is read."""

    def __init__(self, function: Any, *arguments: Any) -> None:
        self.call = (function, arguments)

    def __reduce__(self) -> Any:
        return self.call


@pytest.mark.parametrize("protocol", [0, 2, 4, 5])
def test_code_is_named_and_not_executed(load: Any, tmp_path: Path, protocol: int) -> None:
    mark = tmp_path / "executed"
    content = pickle.dumps({"goat": Payload(os.system, f"touch {mark}")}, protocol=protocol)
    with pytest.raises(UnsafePickleError, match=r"(posix|nt)\.system"):
        load(content)
    assert not mark.exists()


@pytest.mark.parametrize(
    ("value", "name"),
    [
        (Payload(eval, "1"), "eval"),
        (Payload(np.load, "x.npy"), "numpy.*load"),
        (np.ma.masked_array([1.0]), "numpy"),
        (Path("x"), "pathlib"),
        (len, "len"),
    ],
)
def test_anything_else_is_refused_by_name(load: Any, value: Any, name: str) -> None:
    with pytest.raises(UnsafePickleError, match=name):
        load(pickle.dumps(value))


def test_an_object_array_is_no_way_round(load: Any, tmp_path: Path) -> None:
    with pytest.raises(UnsafePickleError, match="'O8'"):
        load(pickle.dumps(np.array([{"plain": 1}], dtype=object)))
    mark = tmp_path / "executed"
    hidden = np.array([Payload(os.system, f"touch {mark}")], dtype=object)
    with pytest.raises(UnsafePickleError):
        load(pickle.dumps(hidden))
    assert not mark.exists()


@pytest.mark.parametrize(
    "value",
    [
        np.zeros(2, dtype=[("a", "f8"), ("b", "O")]),
        np.zeros(2, dtype=[("a", "f8")]),
        np.zeros(2, dtype="M8[s]"),
        np.void(b"abc"),
        np.dtype(object),
    ],
)
def test_structured_and_object_types_are_refused(load: Any, value: Any) -> None:
    with pytest.raises(UnsafePickleError, match="an array"):
        load(pickle.dumps(value))


def forged(dtype_state: tuple[Any, ...] | None, shape: tuple[int, ...], content: Any, spec: str = "f8") -> bytes:
    """An array by hand: a type with a state of one's choice, and content that need not fit the shape."""
    program = b"\x80\x04cnumpy._core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85C\x01b\x87R"
    program += b"(K\x01" + value(shape) + b"cnumpy\ndtype\n" + value((spec, False, True)) + b"R"
    if dtype_state is not None:
        program += value(dtype_state) + b"b"
    return program + b"\x89" + value(content) + b"tb."


def value(plain: Any) -> bytes:
    """The opcodes that push a plain value: its pickle without the protocol, the memo and the stop."""
    if isinstance(plain, bytes):
        return b"B" + struct.pack("<I", len(plain)) + plain
    return pickle.dumps(plain, protocol=3)[2:-1].replace(b"q\x00", b"").replace(b"q\x01", b"")


def test_a_forged_array_of_the_right_shape_is_read(load: Any) -> None:
    np.testing.assert_array_equal(np.asarray(load(forged(None, (2,), bytes(16)))), np.zeros(2))


@pytest.mark.parametrize(
    ("content", "error", "words"),
    [
        (forged(None, (1000,), bytes(16)), DatasetError, "has 16 bytes"),
        (forged(None, (-1,), bytes(16)), DatasetError, "shape"),
        (forged(None, (2,), None), DatasetError, "unknown way"),
        (forged((3, "<", None, ("a",), None, 8, 8, 0), (2,), bytes(16)), UnsafePickleError, "fields"),
        (forged(None, (2,), bytes(16), spec="O8"), UnsafePickleError, "'O8'"),
        (forged(None, (2,), bytes(16), spec="f8,O"), UnsafePickleError, "f8,O"),
        (b"cnumpy\nndarray\n(I1000000000\ntR.", UnsafePickleError, "a call of numpy.ndarray"),
        (b"cnumpy._core.multiarray\n_reconstruct\n}b.", UnsafePickleError, "own functions"),
        (b"cnumpy._core.multiarray\n_reconstruct\n(NI0\nNtR.", UnsafePickleError, "subclass of numpy.ndarray"),
        (b"c_codecs\nencode\n(Vabc\nVzip\ntR.", UnsafePickleError, "'zip'"),
        (b"cnumpy\nndarray.tofile\n.", UnsafePickleError, "ndarray.tofile"),
    ],
)
def test_forged_pickles_are_refused(load: Any, content: bytes, error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        load(content)


@pytest.mark.parametrize("content", [b"", b"no pickle", pickle.dumps({"a": np.zeros(5)})[:-20], b"\x80\x63."])
def test_damaged_files_are_named(load: Any, content: bytes) -> None:
    with pytest.raises(DatasetError, match="is not readable as a TAP-Vid pickle"):
        load(content)


def test_an_absent_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"nowhere.pkl cannot be opened \(No such file"):
        safe_pickle.load(tmp_path / "nowhere.pkl")

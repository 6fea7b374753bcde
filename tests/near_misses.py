"""What damaged and forged files hold, as hypothesis' strategies, and the rule that every reader keeps with them.

The rule: a reader returns what its docstring says, or raises an error of its package's family whose text is one line;
it takes neither long nor much memory.
"""

from __future__ import annotations

import io
import resource
import signal
import struct
import warnings
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
from hypothesis import strategies as st
from hypothesis.extra import numpy as numpy_strategies

from decomotion.errors import InputError

Value = TypeVar("Value")
Arrays = dict[str, npt.NDArray[Any]]

SECONDS = 20
"""Far more than any of these readers takes for a small file."""
BYTES = 2**30
"""Memory that a reader may take beyond what the process has: far more than it needs, and less than a header claims."""
EXTREMES = (0, 1, -1, 127, 255, 2**15, 2**31 - 1, -(2**31), 2**32 - 1, 2**63 - 1, -(2**63))


def answer(read: Callable[[], Value], family: type[InputError] = InputError) -> Value | None:
    """What `read` returns, or None where it refuses; anything else that it does fails the test."""
    try:
        with _bounded():
            return read()
    except family as error:
        text = str(error)
        assert text.strip(), "a refusal without a sentence"
        assert text.isprintable(), f"a refusal is one line of text: {text!r}"
        return None


@contextmanager
def _bounded() -> Iterator[None]:
    """Fails what takes more than `SECONDS`, and refuses memory beyond `BYTES`, where the system can."""
    status = Path("/proc/self/status")
    taken = next((line for line in status.read_text().splitlines() if "VmData" in line), "") if status.exists() else ""
    limits = resource.getrlimit(resource.RLIMIT_DATA)
    handler = signal.signal(signal.SIGALRM, _too_long)
    timer = signal.setitimer(signal.ITIMER_REAL, SECONDS)  # another, of the whole test, may be running
    try:
        if taken:
            resource.setrlimit(resource.RLIMIT_DATA, (int(taken.split()[1]) * 1024 + BYTES, limits[1]))
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, limits)
        signal.signal(signal.SIGALRM, handler)
        signal.setitimer(signal.ITIMER_REAL, *timer)


class ExecutedError(BaseException):
    """Something in a file was called."""


def detonate(*_: object) -> None:
    """What a file names that would like to run code."""
    raise ExecutedError


class TooLongError(BaseException):
    """Not an `Exception`, which a reader may turn into a refusal."""


def _too_long(number: int, frame: FrameType | None) -> None:
    raise TooLongError(f"a reader took more than {SECONDS} seconds")


@st.composite
def near(draw: st.DrawFn, whole: bytes) -> bytes:
    """A file with one to three places damaged: cut off, flipped, overwritten, left out, or there twice."""
    content = bytearray(whole)
    for _ in range(draw(st.integers(1, 3))):
        begin = draw(st.integers(0, len(content)))
        end = draw(st.integers(begin, min(begin + 64, len(content))))
        damage = draw(st.integers(0, 5))
        if damage == 0:
            del content[begin:]
        elif damage == 1 and begin < len(content):
            content[begin] ^= draw(st.integers(1, 255))
        elif damage == 2:
            content[begin:end] = draw(st.binary(max_size=16))
        elif damage == 3:
            del content[begin:end]
        elif damage == 4:
            content[end:end] = content[begin:end]
        else:
            form, value = draw(st.sampled_from(["<i", ">i", "<q", "<H"])), draw(st.sampled_from(EXTREMES))
            size = struct.calcsize(form)
            content[begin : begin + size] = (value % 256**size).to_bytes(size, "little" if form[0] == "<" else "big")
    return bytes(content)


def any_or_near(*wholes: bytes) -> st.SearchStrategy[bytes]:
    """Any bytes, or those of one of these files, damaged."""
    return st.one_of(st.binary(max_size=256), *(near(whole) for whole in wholes))


def any_array() -> st.SearchStrategy[npt.NDArray[Any]]:
    """A small array of any type that a file may hold without code, with any number of axes up to five."""
    types = st.one_of(numpy_strategies.scalar_dtypes(), st.just(np.dtype([("a", "<f4"), ("b", "<i2")])))
    shapes = numpy_strategies.array_shapes(min_dims=0, max_dims=5, min_side=0, max_side=4)
    return types.flatmap(lambda dtype: numpy_strategies.arrays(dtype, shapes))


_EDITS: Sequence[Callable[[npt.NDArray[Any]], npt.NDArray[Any]]] = (
    lambda array: array[:-1],
    lambda array: array[..., :-1],
    lambda array: array[None],
    lambda array: array[..., None],
    lambda array: array[0],
    lambda array: array.T,
    lambda array: array.swapaxes(0, 1),
    lambda array: np.concatenate([array, array]),
    lambda array: array[:0],
    lambda array: array[..., :0],
    lambda array: array[:, :0],
    *(
        (lambda array, dtype=dtype: array.astype(dtype))
        for dtype in ("?", "<i1", ">i8", "<u8", "<f2", ">f4", "<f8", "<c16", "<m8[s]", "<M8[s]", "S3", "<U3")
    ),
)
POISON = (np.nan, np.inf, -np.inf, 1e300, -1e300, 1e30, -1.0, -0.5, 0.5, 2.0, 2.0**40, 1e-320)


@st.composite
def near_arrays(draw: st.DrawFn, arrays: Mapping[str, npt.NDArray[Any]]) -> Arrays:
    """Named arrays with one to three of them wrong: absent, of another type or shape, or with strange values."""
    edited = dict(arrays)
    for _ in range(draw(st.integers(1, 3))):
        key = draw(st.sampled_from(sorted(arrays)))
        array = edited.get(key, arrays[key])
        kind = draw(st.integers(0, 5))
        if kind == 0:
            edited.pop(key, None)
        elif kind == 1:
            edited[key] = draw(any_array())
        elif kind in (2, 3):
            try:
                with warnings.catch_warnings(action="ignore"):
                    edited[key] = draw(st.sampled_from(_EDITS))(array)
            except (ValueError, TypeError, LookupError, RuntimeError):  # an edit that this array does not admit
                edited.pop(key, None)
        elif array.size and array.dtype.kind in "biuf":
            values = array.astype(np.float64)
            some = draw(numpy_strategies.arrays(np.bool_, st.just(array.shape), fill=st.booleans()))
            edited[key] = np.where(some, draw(st.sampled_from(POISON)), values)
    return edited


def npz(arrays: Mapping[str, npt.NDArray[Any]]) -> bytes:
    """The file of some arrays."""
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    return file.getvalue()


def npy(array: npt.NDArray[Any]) -> bytes:
    """The file of an array."""
    file = io.BytesIO()
    np.save(file, array, allow_pickle=False)
    return file.getvalue()


_TYPES = (
    *("'<f4'", "'<f8'", "'|u1'", "'|O'", "'|b1'", "'<c16'", "'<U7'", "'|S0'", "'|V0'", "'<f0'", "'<M8[s]'", "''"),
    *("()", "[]", "[('a', '<f4')]", "[('a', '|O')]", "('<f4', (3,))", "('<f4',)", "((), ())", "3", "None", "b'f4'"),
    *("'(99999,99999,99999)f4'", "'" + "f" * 99 + "'", "[('a', '<f4'), ('a', '<f4')]", "{'a': 1}", "print"),
)
_SHAPES = (
    *("()", "(2, 3)", "(-1,)", "(-2, -3)", "(0,)", "(0, -1)", "(1.5,)", "('a',)", "[2, 3]", "3", "None", "(None,)"),
    *("(1000000000000,)", "(4294967296, 4294967296)", "(9223372036854775807, 2)", "(2, 10**9)", "(0, 2**62)"),
    *("(0, 4611686018427387904, 4)", "(" + "9" * 99 + ",)", "(" + "1, " * 99 + ")", "(True, 2)", "(2147483648,)"),
    *("(1000, 1000, 1000)", "(10L,)", "(" * 150 + ")" * 150, "(2, 3", "((2, 3),)"),
)


@st.composite
def forged_npy(draw: st.DrawFn) -> bytes:
    """A .npy file whose header says what its content is not."""
    described = draw(st.sampled_from(_TYPES)), draw(st.sampled_from(_SHAPES))
    order = draw(st.sampled_from(("False", "True", "0", "'C'")))
    header = f"{{'descr': {described[0]}, 'fortran_order': {order}, 'shape': {described[1]}, }}"
    more = draw(st.sampled_from(("", " ", "\n", "#", ", 1", "\0", "é", "}")))
    text = (header + more + "\n").encode()
    version = draw(st.sampled_from((1, 2, 3, 4, 255)))
    length = len(text) + draw(st.sampled_from((0, 0, 0, 1, -1, 60000)))
    size = struct.pack("<H" if version == 1 else "<I", length % 2**16)
    return b"\x93NUMPY" + bytes([version, 0]) + size + text + draw(st.binary(max_size=64))


@st.composite
def forged_zip(draw: st.DrawFn, members: Sequence[tuple[str, bytes]], *contents: st.SearchStrategy[bytes]) -> bytes:
    """A whole zip file of these members, some of them damaged, absent, there twice, of other names or contents."""
    file = io.BytesIO()
    method = draw(st.sampled_from((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA)))
    with zipfile.ZipFile(file, "w", method) as archive, warnings.catch_warnings(action="ignore"):
        for name, content in members:
            fate = draw(st.integers(0, 9))
            if fate == 0:
                continue
            if fate == 1:
                name = draw(st.sampled_from((name.removesuffix(".npy"), name.upper(), f"../{name}", "a/", "\n")))
            if fate in (2, 3):
                content = draw(st.one_of(near(content), *contents))
            for _ in range(2 if fate == 4 else 1):
                archive.writestr(name, content)
    return file.getvalue()


def plain_tree(leaves: st.SearchStrategy[Any] | None = None) -> st.SearchStrategy[Any]:
    """What JSON and YAML hold: numbers of any size, text, lists and mappings."""
    scalars = st.one_of(st.none(), st.booleans(), st.integers(), st.sampled_from(EXTREMES), st.floats(), st.text())
    return st.recursive(
        scalars if leaves is None else scalars | leaves,
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
        max_leaves=8,
    )


@st.composite
def near_tree(draw: st.DrawFn, whole: Any, others: st.SearchStrategy[Any] | None = None) -> Any:
    """A copy of nested mappings and lists with one place, somewhere in it, absent, exchanged or more than there was."""
    others = plain_tree() if others is None else others
    if not isinstance(whole, dict | list) or not whole or draw(st.integers(0, 5)) == 0:
        return draw(others)
    copy = dict(enumerate(whole)) if isinstance(whole, list) else dict(whole)
    key = draw(st.sampled_from(list(copy)))
    fate = draw(st.integers(0, 5))
    if fate == 0:
        del copy[key]
    elif fate == 1:
        copy[draw(st.text(max_size=5))] = draw(others)
    else:
        copy[key] = draw(near_tree(copy[key], others))
    return list(copy.values()) if isinstance(whole, list) else copy

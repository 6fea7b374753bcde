"""Pickles of numpy arrays and plain containers, read without executing anything that they name.

A pickle is a program that may call any function. Here every name resolves to a stand-in of our own or is refused, so
the only calls are to the few functions below. They rebuild arrays of numbers and strings from bytes whose length is
checked; numpy's own unpickling trusts the description of an array, which can be forged to point anywhere (object and
structured types, field offsets). Written by numpy 1 or 2, pickle protocols 2 to 5.
"""

from __future__ import annotations

import math
import pickle
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from decomo_eval.errors import DatasetError, UnsafePickleError

_PLAIN_TYPE = re.compile(r"[biufcSU][1-9]\d*")
"""Boolean, integer, float, complex number, byte and unicode string, with its size, as numpy spells it in a pickle."""


def load(path: str | Path) -> Any:
    """The pickle's content: dict, list, tuple, set, str, bytes, numbers, None and numpy arrays of these.

    Raises `UnsafePickleError` where it names anything else, `DatasetError` where it cannot be read. An array may come
    back as a subclass of `numpy.ndarray`; `numpy.asarray` makes it a plain one.
    """
    with telling(path, "a TAP-Vid pickle"), open(path, "rb") as file:
        return Unpickler(file).load()


@contextmanager
def telling(path: str | Path, wanted: str) -> Iterator[None]:
    """What goes wrong while a pickle is read, as one `DatasetError` that names the file and what it should be."""
    try:
        yield
    except UnsafeError as error:
        raise UnsafePickleError(
            f"{path} was refused, nothing in it executed: it holds {error}, and a dataset may hold only numpy arrays "
            "and plain containers"
        ) from None
    except OSError as error:
        raise DatasetError(f"{path} cannot be opened ({error.strerror}); give {wanted}") from error
    except Exception as error:  # the unpickler and the stand-ins raise what a damaged program brings them to
        raise DatasetError(f"{path} is not readable as {wanted} ({error}); is the file whole?") from error


class UnsafeError(Exception):
    """Its text names what was found."""


class StandIn:
    """What a name in the pickle resolves to: it can be called, and neither changed nor instantiated."""

    __slots__ = ("_make",)

    def __init__(self, make: Callable[..., Any]) -> None:
        """Of what is called in the place of the name."""
        self._make = make

    def __call__(self, *args: Any) -> Any:
        """What the stand-in makes of the arguments."""
        return self._make(*args)

    def __setstate__(self, state: Any) -> None:
        raise UnsafeError("an attempt to change the reader's own functions")


class _Dtype:
    """A number or string type, as a pickle spells it: `dtype("f8", False, True)`, then its byte order as state."""

    __slots__ = ("dtype",)

    def __init__(self, spec: str, *_flags: Any) -> None:
        if not isinstance(spec, str) or not _PLAIN_TYPE.fullmatch(spec):
            raise UnsafeError(f"an array of type {spec!r}")
        self.dtype = np.dtype(spec)

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        _version, byte_order, subarray, names, fields, *_sizes = state
        if (subarray, names, fields) != (None, None, None):
            raise UnsafeError("an array with fields")
        self.dtype = self.dtype.newbyteorder(byte_order)


class _Array(np.ndarray):
    """An array that fills itself from checked bytes when the pickle gives it its state."""

    def __setstate__(self, state: tuple[Any, ...], /) -> None:
        version, shape, dtype, is_fortran, content = state
        _check_content(dtype, shape, content)
        super().__setstate__((version, shape, dtype.dtype, is_fortran, content))


def _check_content(dtype: object, shape: object, content: object) -> None:
    """Raises ValueError unless `content` is as many bytes as an array of this type and shape takes."""
    if not isinstance(dtype, _Dtype) or not isinstance(shape, tuple) or not isinstance(content, bytes | bytearray):
        raise ValueError("an array is described in an unknown way")
    if not all(isinstance(length, int) and length >= 0 for length in shape):
        raise ValueError(f"an array has shape {shape}")
    if len(content) != dtype.dtype.itemsize * math.prod(shape):
        raise ValueError(f"an array of shape {shape} and type {dtype.dtype} has {len(content)} bytes")


def _reconstruct(kind: object, _shape: object, _typecode: object) -> _Array:
    """`_reconstruct(ndarray, (0,), b"b")`, as protocols up to 4 begin an array."""
    if kind is not _NDARRAY:
        raise UnsafeError("a subclass of numpy.ndarray")
    return np.ndarray.__new__(_Array, (0,), np.int8)


def _from_buffer(content: bytes, dtype: _Dtype, shape: tuple[int, ...], order: str) -> npt.NDArray:
    """`_frombuffer(bytes, dtype, shape, order)`, as protocol 5 writes a contiguous array."""
    _check_content(dtype, shape, content)
    return np.frombuffer(content, dtype.dtype).reshape(shape, order="F" if order == "F" else "C")


def _scalar(dtype: _Dtype, content: bytes) -> np.generic:
    """`scalar(dtype, bytes)`."""
    _check_content(dtype, (), content)
    return np.frombuffer(content, dtype.dtype)[0]


def _encode(text: str, encoding: str) -> bytes:
    """`_codecs.encode(text, "latin1")`, as protocol 2 writes bytes."""
    if encoding != "latin1":
        raise UnsafeError(f"bytes in the encoding {encoding!r}")
    return text.encode("latin1")


def _array_type(*_args: object) -> None:
    raise UnsafeError("a call of numpy.ndarray")


def _empty(kind: type) -> Callable[[], Any]:
    return lambda: kind()


_NDARRAY = StandIn(_array_type)
_STAND_INS = {
    ("numpy", "ndarray"): _NDARRAY,
    ("numpy", "dtype"): StandIn(_Dtype),
    ("_codecs", "encode"): StandIn(_encode),
    ("__builtin__", "bytes"): StandIn(_empty(bytes)),
    ("collections", "OrderedDict"): StandIn(_empty(dict)),
}
for _core in ("numpy.core", "numpy._core"):  # numpy 1, numpy 2
    _STAND_INS[f"{_core}.multiarray", "_reconstruct"] = StandIn(_reconstruct)
    _STAND_INS[f"{_core}.multiarray", "scalar"] = StandIn(_scalar)
    for _module in ("multiarray", "numeric"):
        _STAND_INS[f"{_core}.{_module}", "_frombuffer"] = StandIn(_from_buffer)


class Unpickler(pickle._Unpickler):
    """Finds our stand-ins and nothing else, and takes no more memory than the file has bytes.

    It is the one in Python: that in C makes room for as many things as the number that one of them is kept under.
    """

    stack: list[Any]
    stand_ins: ClassVar[Mapping[tuple[str, str], StandIn]] = _STAND_INS
    dispatch: ClassVar[dict[int, Callable[[Any], None]]] = {**pickle._Unpickler.dispatch}

    def find_class(self, module: str, name: str) -> Any:
        """The stand-in of a name; `UnsafeError` where there is none."""
        if (module, name) not in self.stand_ins:
            raise UnsafeError(f"{module}.{name}")
        return self.stand_ins[module, name]

    def load_bytearray8(self) -> None:
        """Reads as many bytes as there are; Python's own first fills as many with zeros as the file says."""
        self.dispatch[pickle.BINBYTES8[0]](self)
        self.stack[-1] = bytearray(self.stack[-1])

    dispatch[pickle.BYTEARRAY8[0]] = load_bytearray8


def _without_tuples(load: Callable[[Any], None], keys: slice) -> Callable[[Any], None]:
    """An instruction that hashes `keys` of the stack; deeply nested tuples among them would overflow Python's own."""

    def checked(unpickler: Unpickler) -> None:
        if any(isinstance(key, tuple) for key in unpickler.stack[keys]):
            raise UnsafeError("a tuple as a key")
        load(unpickler)

    return checked


for _code, _keys in (
    (pickle.SETITEM, slice(-2, -1)),
    (pickle.SETITEMS, slice(0, None, 2)),
    (pickle.DICT, slice(0, None, 2)),
    (pickle.ADDITEMS, slice(None)),
    (pickle.FROZENSET, slice(None)),
):
    Unpickler.dispatch[_code[0]] = _without_tuples(Unpickler.dispatch[_code[0]], _keys)

"""Tensors in files of `torch.save` as numpy arrays: neither torch is needed nor anything executed that a file names.

Since torch 1.6 such a file is a zip archive of a pickle, `data.pkl`, which describes each tensor by a storage, an
offset, a shape and strides, and of the storages' bytes, `data/0`, `data/1`, ... Only what is asked for is read.
"""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from decomo_eval.safe_pickle import StandIn, Unpickler, UnsafeError, telling

_TYPES = {
    **{"FloatStorage": "f4", "DoubleStorage": "f8", "HalfStorage": "f2", "BoolStorage": "u1", "ByteStorage": "u1"},
    **{"CharStorage": "i1", "ShortStorage": "i2", "IntStorage": "i4", "LongStorage": "i8"},
}
"""numpy's names of the types of a storage's values."""


def load_tensors(path: str | Path, keys: Collection[str]) -> dict[str, npt.NDArray[Any]]:
    """The tensors of a saved dict that have these keys, as far as it has them.

    Raises `UnsafePickleError` where the file names anything but tensors and plain containers, `DatasetError` where it
    cannot be read.
    """
    with telling(path, "a dict of tensors, saved by torch 1.6 or later"), zipfile.ZipFile(path) as archive:
        (program,) = (name for name in archive.namelist() if name.endswith("/data.pkl"))
        root = program.removesuffix("data.pkl")
        content = _Unpickler(io.BytesIO(_member(archive, program))).load()
        if not isinstance(content, dict):
            raise ValueError(f"it holds a {type(content).__name__}")
        order = f"{root}byteorder"
        written = "little" if order not in archive.namelist() else _member(archive, order).decode("ascii")
        found = {key: content[key] for key in keys if key in content}
        if other := [key for key, value in found.items() if not isinstance(value, _Tensor)]:
            raise ValueError(f"{other[0]} is not a tensor")
        return {key: _read(archive, root, tensor, written) for key, tensor in found.items()}


class _Plain:
    """What the pickle makes: it cannot be changed by it."""

    def __setstate__(self, state: Any) -> None:
        raise UnsafeError("an attempt to change a tensor")


@dataclass(frozen=True)
class _Storage(_Plain):
    """Bytes in the archive."""

    key: str
    type: str
    length: int


@dataclass(frozen=True, eq=False)
class _Tensor(_Plain):
    """A view of a storage."""

    storage: _Storage
    offset: int
    shape: tuple[int, ...]
    strides: tuple[int, ...]


def _tensor(storage: object, offset: object, shape: object, strides: object, *_: object) -> _Tensor:
    """`_rebuild_tensor_v2(storage, offset, size, stride, requires_grad, backward_hooks)`."""
    if not isinstance(storage, _Storage) or not isinstance(shape, tuple) or not isinstance(strides, tuple):
        raise ValueError("a tensor is described in an unknown way")
    if len(shape) != len(strides) or not all(type(n) is int and n >= 0 for n in (offset, *shape, *strides)):
        raise ValueError(f"a tensor has shape {shape} and strides {strides}")
    assert isinstance(offset, int)
    last = offset + sum((length - 1) * stride for length, stride in zip(shape, strides, strict=True))
    size = math.prod(shape)
    if size > storage.length or (size and last >= storage.length):
        raise ValueError(f"a tensor of shape {shape} and strides {strides} is larger than its storage")
    return _Tensor(storage, offset, shape, strides)


def _refused(*_: object) -> None:
    raise UnsafeError("a call of a type of storage")


_STORAGES = {name: StandIn(_refused) for name in _TYPES}


class _Unpickler(Unpickler):
    """Finds tensors besides what a TAP-Vid pickle may hold."""

    stand_ins: ClassVar[Mapping[tuple[str, str], StandIn]] = {
        **Unpickler.stand_ins,
        ("torch._utils", "_rebuild_tensor_v2"): StandIn(_tensor),
        **{("torch", name): stand_in for name, stand_in in _STORAGES.items()},
    }

    def persistent_load(self, pid: Any) -> _Storage:
        """A storage: `("storage", type, key, device, length)`."""
        kind, of_type, key, _device, length = pid
        names = [name for name, stand_in in _STORAGES.items() if stand_in is of_type]
        if kind != "storage" or not names or not isinstance(key, str) or type(length) is not int:
            raise ValueError("a storage is described in an unknown way")
        return _Storage(key, names[0], length)


def _member(archive: zipfile.ZipFile, name: str) -> bytes:
    """A member's bytes, which torch does not compress: they are no more than the file has."""
    if archive.getinfo(name).compress_type != zipfile.ZIP_STORED:
        raise ValueError(f"{name} is compressed")
    return archive.read(name)


def _read(archive: zipfile.ZipFile, root: str, tensor: _Tensor, order: str) -> npt.NDArray[Any]:
    if order not in ("little", "big"):
        raise ValueError(f"its bytes are in the order {order!r}")
    dtype = np.dtype(_TYPES[tensor.storage.type]).newbyteorder(order)
    content = _member(archive, f"{root}data/{tensor.storage.key}")
    if len(content) != tensor.storage.length * dtype.itemsize:
        raise ValueError(f"a storage of {tensor.storage.length} values has {len(content)} bytes")
    strides = [stride * dtype.itemsize for stride in tensor.strides]
    if math.prod(tensor.shape) == 0:
        values = np.zeros(tensor.shape, dtype)
    else:
        values = np.ndarray(tensor.shape, dtype, content, tensor.offset * dtype.itemsize, strides).copy()
    return values != 0 if tensor.storage.type == "BoolStorage" else values.astype(dtype.newbyteorder("="))

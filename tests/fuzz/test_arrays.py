"""Array files (`decomotion/arrays.py`) and flow fields: .npy, .npz, .flo."""

from __future__ import annotations

import io
import struct
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from decomotion.arrays import npz_keys, read_npy, read_npz
from decomotion.data.flow.folder import FLO_MAGIC, read_field
from decomotion.errors import InputError, SupervisionError
from near_misses import EXTREMES, answer, any_array, any_or_near, forged_npy, forged_zip, near, near_arrays, npy, npz


class ReaderError(InputError):
    """The caller's own."""


FIELD = np.linspace(-3, 3, 5 * 7 * 2, dtype=np.float32).reshape(5, 7, 2)
ARRAYS = {"tracks": FIELD, "occluded": FIELD[..., 0] > 0, "count": np.array(3)}
MEMBERS = [(f"{name}.npy", npy(array)) for name, array in ARRAYS.items()]
FLO = struct.pack("<fii", FLO_MAGIC, 7, 5) + FIELD.tobytes()


@given(content=st.one_of(any_or_near(npy(FIELD)), forged_npy(), any_array().map(npy)))
def test_npy(place: Path, content: bytes):
    (place / "a.npy").write_bytes(content)
    array = answer(lambda: read_npy(place / "a.npy", ReaderError), ReaderError)
    assert array is None or (isinstance(array, np.ndarray) and not array.dtype.hasobject)


@given(
    content=st.one_of(
        any_or_near(npz(ARRAYS)),
        forged_zip(MEMBERS, forged_npy(), st.just(npz(ARRAYS))),
        forged_zip(MEMBERS).flatmap(near),
        forged_zip(MEMBERS).map(lambda archive: npy(FIELD) + archive),
        near_arrays(ARRAYS).map(npz),
    )
)
def test_npz(place: Path, content: bytes):
    file = place / "a.npz"
    file.write_bytes(content)
    arrays = answer(lambda: read_npz(file, ReaderError), ReaderError)
    keys = answer(lambda: npz_keys(file, ReaderError), ReaderError)
    one = answer(lambda: read_npz(file, ReaderError, ("count",)), ReaderError)
    if arrays is not None:
        assert list(arrays) == keys
        assert one is not None
        assert one.keys() == arrays.keys() & {"count"}
        assert all(isinstance(array, np.ndarray) and not array.dtype.hasobject for array in arrays.values())


def packed(*members: tuple[str, bytes], method: int = zipfile.ZIP_STORED) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as archive, warnings.catch_warnings(action="ignore"):
        for name, content in members:
            archive.writestr(name, content)
    return file.getvalue()


def headed(shape: str) -> bytes:
    """A .npy file of that shape, and 16 bytes of content."""
    header = f"{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + bytes(16)


@pytest.mark.parametrize("shape", ["(3000000000,)", "(10000000000000,)", "(10000000000000000000000,)", "(-4,)", "(5,)"])
def test_a_header_that_lies(place: Path, shape: str):
    """Of the lengths some are more than memory holds, and some more than a number of 64 bits."""
    (place / "a.npy").write_bytes(headed(shape))
    (place / "a.npz").write_bytes(packed(("count.npy", headed(shape))))
    assert answer(lambda: read_npy(place / "a.npy", ReaderError), ReaderError) is None
    assert answer(lambda: read_npz(place / "a.npz", ReaderError), ReaderError) is None


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (npy(FIELD) + packed(("count.npy", npy(FIELD))), None),  # numpy takes it for the array that it begins with
        (packed(("count", npy(FIELD))), "it holds 'count'"),
        (packed(("count.txt", b"3")), "it holds 'count.txt'"),
        (packed(("count.npy", b"3")), "magic"),
        (packed(("count.npy", npy(FIELD)), ("count.npy", npy(FIELD[:1]))), "two arrays of one name"),
        (packed(("count.npy", npy(FIELD)), method=zipfile.ZIP_LZMA).replace(b"]\0\0", b"\xff\0\0", 1), "damaged"),
    ],
)
def test_archives_that_are_no_npz(place: Path, content: bytes, reason: str | None):
    (place / "a.npz").write_bytes(content)
    if reason is None:
        assert read_npz(place / "a.npz", ReaderError).keys() == {"count"}
    else:
        with pytest.raises(ReaderError, match=reason):
            read_npz(place / "a.npz", ReaderError)


def test_a_field_that_float32_does_not_hold(place: Path):
    (place / "0_1.npy").write_bytes(npy(np.full((5, 7, 2), 1e300)))
    with pytest.raises(SupervisionError, match="not finite"):
        read_field(place / "0_1.npy")


def _check_field(file: Path) -> None:
    field = answer(lambda: read_field(file), SupervisionError)
    if field is not None:
        assert field.dtype == np.float32
        assert field.ndim == 3
        assert field.shape[2] == 2
        assert field.size
        assert np.isfinite(field).all()


@given(
    content=st.one_of(
        any_or_near(npy(FIELD)), forged_npy(), near_arrays({"field": FIELD}).map(lambda a: npy(a.get("field", FIELD)))
    )
)
def test_field_as_npy(place: Path, content: bytes):
    (place / "0_1.npy").write_bytes(content)
    _check_field(place / "0_1.npy")


@given(
    content=st.one_of(
        any_or_near(FLO),
        st.builds(
            lambda magic, width, height, body: struct.pack("<fII", magic, width % 2**32, height % 2**32) + body,
            st.sampled_from((FLO_MAGIC, -FLO_MAGIC)),
            st.sampled_from((*EXTREMES, 7, 5, -7, -5)),
            st.sampled_from((*EXTREMES, 7, 5, -7, -5)),
            near_arrays({"field": FIELD}).map(lambda arrays: arrays.get("field", FIELD).astype("V").tobytes()),
        ),
    )
)
def test_field_as_flo(place: Path, content: bytes):
    (place / "0_1.flo").write_bytes(content)
    _check_field(place / "0_1.flo")

"""Array files (`decomotion/arrays.py`) and flow fields: .npy, .npz, .flo."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
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

"""Files of arrays: whatever byte is damaged, one sentence of the caller's own kind of error."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from decomotion.arrays import allocated_memmap, npz_keys, read_npy, read_npz
from decomotion.errors import ClipError
from full_disk import small_disk

ARRAYS = {"points": np.arange(6, dtype=np.float32).reshape(2, 3), "count": np.array(2)}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    np.savez_compressed(tmp_path / "a.npz", **ARRAYS)
    return tmp_path / "a.npz"


def test_all_arrays_or_those_asked_for(file: Path):
    arrays = read_npz(file, ClipError)
    assert arrays.keys() == ARRAYS.keys()
    np.testing.assert_array_equal(arrays["points"], ARRAYS["points"])
    assert read_npz(file, ClipError, ("count", "absent")).keys() == {"count"}
    assert npz_keys(file, ClipError) == list(ARRAYS)


def test_any_damaged_byte_is_told_or_harmless(file: Path):
    whole, told = file.read_bytes(), 0
    for place in range(len(whole)):
        for value in (0, 0x5A, 0xFF):  # lengths, flags of encryption, versions and methods that zipfile has not
            file.write_bytes(whole[:place] + bytes([value]) + whole[place + 1 :])
            try:
                read_npz(file, ClipError)
            except ClipError:
                told += 1
    assert told > len(whole)


def test_the_remedy_is_the_callers(tmp_path: Path):
    with pytest.raises(ClipError, match=r"a\.npz is not .*; write it anew$"):
        read_npz(tmp_path / "a.npz", ClipError, remedy="write it anew")
    with pytest.raises(ClipError, match=r"a\.npz is not .*; replace it$"):
        npz_keys(tmp_path / "a.npz", ClipError)


def test_one_array(tmp_path: Path, file: Path):
    np.save(tmp_path / "a.npy", ARRAYS["points"])
    np.testing.assert_array_equal(read_npy(tmp_path / "a.npy", ClipError), ARRAYS["points"])
    whole = (tmp_path / "a.npy").read_bytes()
    np.save(tmp_path / "object.npy", np.array([len], object), allow_pickle=True)
    (tmp_path / "short.npy").write_bytes(whole[:-1])
    (tmp_path / "header.npy").write_bytes(whole.replace(b"}", b"("))
    for name in ("object.npy", "short.npy", "header.npy", "absent.npy", file.name):
        with pytest.raises(ClipError, match=r"is not an \.npy file of a plain array, or is damaged"):
            read_npy(tmp_path / name, ClipError)


@pytest.mark.parametrize("shape", [(3, 500, 7), (0, 4)])
def test_a_mapped_file_holds_what_is_stored(tmp_path: Path, shape: tuple[int, ...]):
    values = np.random.default_rng(0).integers(0, 2**16, shape, np.uint16)
    mapped = allocated_memmap(tmp_path / "a.npy", np.uint16, shape)
    assert not mapped.any()
    mapped[:] = values
    mapped.flush()
    np.testing.assert_array_equal(np.load(tmp_path / "a.npy"), values)
    np.testing.assert_array_equal(allocated_memmap(tmp_path / "a.npy", np.uint16, shape, keep=True), values)
    assert not allocated_memmap(tmp_path / "a.npy", np.uint16, shape).any()
    assert [file.name for file in tmp_path.iterdir()] == ["a.npy"]


def test_a_mapped_file_has_no_holes_that_a_full_disk_could_not_fill(tmp_path: Path):
    with small_disk(tmp_path / "disk", 2**20) as folder:
        allocated_memmap(folder / "a.npy", np.uint8, (2**19,))
        with pytest.raises(OSError, match=rf"No space left on device: '{folder / 'b.npy'}'"):
            allocated_memmap(folder / "b.npy", np.float32, (2, 2**17))
        assert [file.name for file in folder.iterdir()] == ["a.npy"]

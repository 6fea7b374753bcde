"""Memory that is kept for the next large tensor, or given back."""

import platform
import resource
from pathlib import Path

import numpy as np
import pytest
import torch

from decomotion.memory import forget, kept_memory, returned_memory

pytestmark = pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="a setting of glibc's allocator")

LARGE = 48 << 20
"""Bytes; above what glibc ever keeps by itself."""
PAGES = LARGE // resource.getpagesize()


ROUNDS, TENSORS = 10, 3


def work() -> None:
    """Makes several large tensors, one after the other."""
    for _ in range(ROUNDS):
        first = torch.ones(LARGE // 4)
        second = first + 1
        del first
        second.mul(2)


def resident_pages() -> int:
    """Of this process."""
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])


def page_faults() -> int:
    """Of `work`."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    work()
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before


def test_large_tensors_reuse_memory() -> None:
    without = page_faults()
    if without < ROUNDS * TENSORS * PAGES / 2:
        pytest.skip("large pages are always on here: there are few page faults to save")
    with kept_memory():
        within = page_faults()
    assert within < without / 2


def test_memory_is_returned_afterwards() -> None:
    before = resident_pages()
    with kept_memory():
        work()
    assert resident_pages() < before + PAGES


def test_frames_that_pass_between_others_that_stay_leave_no_gaps() -> None:
    np.ones(LARGE // 2, np.uint8)  # from here on glibc takes smaller ones from its heap
    before, count, size = resident_pages(), 16, LARGE // 16
    with returned_memory():
        passing, staying = [], []
        for _ in range(count):
            passing.append(np.ones(size, np.uint8))
            staying.append(np.ones(size, np.uint8))
        passing.clear()
        assert resident_pages() < before + (count + 1) * PAGES // 16
    assert len(staying) == count


def test_what_is_mapped_is_forgotten_and_read_again(tmp_path: Path) -> None:
    mapped = np.lib.format.open_memmap(tmp_path / "mapped.npy", mode="w+", dtype=np.uint8, shape=(4, LARGE // 4))
    mapped[:] = 7
    before = resident_pages()
    forget(mapped[1:, ::2])  # a part stands for all
    assert resident_pages() < before - 0.9 * PAGES
    assert (mapped[:, :: LARGE // 64] == 7).all()
    forget(np.zeros(3))


def test_memory_is_returned_after_a_failure() -> None:
    before = resident_pages()

    def fail() -> None:
        with kept_memory():
            work()
            raise RuntimeError("stopped")

    with pytest.raises(RuntimeError, match="stopped"):
        fail()
    assert resident_pages() < before + PAGES

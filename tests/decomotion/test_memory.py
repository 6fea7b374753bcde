"""Memory that is kept for the next large tensor, or given back."""

import platform
import resource
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from decomotion.memory import forget, kept_memory

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


PASSING_AND_STAYING = f"""
import numpy as np
from decomotion.memory import returned_memory

def resident() -> int:
    return int(open("/proc/self/statm").read().split()[1])

np.ones({LARGE // 2}, np.uint8)  # from here on glibc takes smaller ones from its heap
before = resident()
with returned_memory():
    passing, staying = [], []
    for _ in range(16):
        passing.append(np.ones({LARGE // 16}, np.uint8))
        staying.append(np.ones({LARGE // 16}, np.uint8))
    passing.clear()
    print(resident() - before)
"""


def test_frames_that_pass_between_others_that_stay_leave_no_gaps() -> None:
    """In a process of its own: what others have left free in the heap is taken first."""
    found = subprocess.run([sys.executable, "-c", PASSING_AND_STAYING], capture_output=True, timeout=60, check=True)
    assert int(found.stdout) < 17 * PAGES // 16


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

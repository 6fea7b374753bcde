"""Chance: the one place where random numbers come from.

What is drawn depends on a seed, on what it is drawn for, and on the step for which it is, and on nothing else: two
seeds, purposes or steps share no numbers, and a run that goes on from its checkpoint draws what it would have drawn.
The three are hashed together, since generators tell neighbouring seeds apart badly or, as torch's on the CPU with all
but the low 32 bits of a seed, not at all.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import torch


def generator(seed: int, purpose: str, step: int = 0) -> np.random.Generator:
    """Numpy's generator for one purpose and step."""
    return np.random.default_rng(_sequence(seed, purpose, step))


def torch_generator(seed: int, purpose: str, step: int = 0, device: torch.device | str = "cpu") -> torch.Generator:
    """Torch's generator for one purpose and step, on `device`."""
    return torch.Generator(device).manual_seed(_hashed(seed, purpose, step))


@contextmanager
def first_weights(seed: int) -> Iterator[None]:
    """Within it torch's layers draw their first weights by `seed`; torch's own generator is afterwards as it was.

    Layers take no generator: they draw from the global one.
    """
    with torch.random.fork_rng(devices=[]):
        torch.default_generator.manual_seed(_hashed(seed, "first weights", 0))
        yield


def _sequence(seed: int, purpose: str, step: int) -> np.random.SeedSequence:
    named = int.from_bytes(hashlib.sha256(purpose.encode()).digest()[:8], "little")
    return np.random.SeedSequence((seed, named, step))


def _hashed(seed: int, purpose: str, step: int) -> int:
    return int(_sequence(seed, purpose, step).generate_state(1, np.uint64)[0])

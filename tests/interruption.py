"""Something that happens in the middle of a fit: Ctrl-C, or a sudden end."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from decomotion.run import Run


@contextmanager
def interruption(step: int, act: Callable[[], object]) -> Iterator[None]:
    """Calls `act` at the beginning of that step of every run."""
    whole = Run.optimise

    def optimise(run: Run, progress: float) -> dict[str, float]:
        if run.step == step:
            act()
        return whole(run, progress)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Run, "optimise", optimise)
        yield


def ctrl_c() -> None:
    """Presses it, where someone waits for it: otherwise it would end the tests."""
    assert signal.getsignal(signal.SIGINT) is not signal.default_int_handler, "nobody waits for Ctrl-C"
    os.kill(os.getpid(), signal.SIGINT)


class Killed(BaseException):
    """As sudden as kill -9: nobody handles it."""


def killed() -> None:
    """The end."""
    raise Killed

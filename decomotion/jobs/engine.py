"""Where attempts run, and which task is next: the order and the retries are the same on every engine."""

from __future__ import annotations

import logging
import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from typing import Protocol, TypeVar, runtime_checkable

from decomotion.jobs.task import Outcome, Place, Task

logger = logging.getLogger(__name__)

PATIENCE = 5
"""Seconds for which a run that is interrupted waits for commands that were interrupted with it: they save first."""

AnyTask = TypeVar("AnyTask", bound=Task)


@dataclass(frozen=True)
class Room:
    """Room for attempts, while the engine runs."""

    jobs: int
    """Attempts that are submitted at a time."""
    submit: Callable[[Task, int], Future[Outcome]]
    """Starts an attempt of a task, by its number from 1. An exception of the future's is an attempt that was lost."""
    fit: Callable[[], int] | None = None
    """How many there is room for now, where that may be fewer: others wait."""

    @property
    def at_a_time(self) -> int:
        """Attempts that run beside one another, as far as can be told now."""
        return self.jobs if self.fit is None else max(1, min(self.jobs, self.fit()))


@runtime_checkable
class Engine(Protocol):
    """Runs attempts somewhere."""

    def start(self) -> AbstractContextManager[Room]:
        """Left before all is done, it starts nothing more. Raises `EngineError` where it cannot run tasks."""
        ...


@dataclass(frozen=True)
class LocalEngine:
    """Attempts on this machine, `jobs` at a time, which share its cores."""

    jobs: int = 1
    threads: int | None = None
    """Of each attempt. Default: an equal share of the cores."""

    @contextmanager
    def start(self) -> Iterator[Room]:
        """Left before all is done, it ends what still runs: by Ctrl-C, after `PATIENCE`."""
        threads = self.threads or max(1, (os.cpu_count() or 1) // self.jobs)
        pool = ThreadPoolExecutor(self.jobs, thread_name_prefix="decomo-job")
        begun: list[Future[Outcome]] = []
        lifeline, end = os.pipe()

        def submit(task: Task, number: int) -> Future[Outcome]:
            begun.append(pool.submit(task.attempt, number, Place(threads, lifeline=lifeline)))
            return begun[-1]

        try:
            yield Room(self.jobs, submit)
        except KeyboardInterrupt:
            wait(begun, PATIENCE)
            raise
        finally:
            os.close(end)
            pool.shutdown(cancel_futures=True)
            os.close(lifeline)


def run_tasks(
    tasks: Sequence[AnyTask],
    room: Room,
    ready: Callable[[AnyTask], AnyTask | Outcome],
    record: Callable[[AnyTask, Outcome], Outcome],
) -> Iterator[Outcome]:
    """Runs the tasks; yields the last outcome of each, as they come.

    A task whose attempt fails or is lost goes to the end of the queue, `Task.attempts` times at most; the others go on.

    Args:
        tasks: in the order in which they are begun.
        room: where they run.
        ready: makes ready what an attempt needs, and gives the task as it is to be run; of one that needs no attempt,
            or can have none, its outcome.
        record: keeps what came of an attempt, and returns it as it is to be told: an attempt may have been lost and yet
            have come to its end.
    """
    queue = deque((task, 1) for task in tasks)
    running: dict[Future[Outcome], tuple[AnyTask, int]] = {}
    while queue or running:
        while queue and len(running) < room.jobs:
            task, number = queue.popleft()
            prepared = ready(task)
            if isinstance(prepared, Outcome):
                yield prepared
            else:
                running[room.submit(prepared, number)] = prepared, number
        for future in wait(running, return_when=FIRST_COMPLETED).done:
            task, number = running.pop(future)
            outcome = record(task, replace(_outcome(task, number, future), jobs=room.at_a_time))
            if outcome.error is None or number == task.attempts:
                yield outcome
            else:
                logger.info("%s, attempt %d of %d: %s", task.name, number, task.attempts, outcome.error)
                queue.append((task, number + 1))


def _outcome(task: Task, number: int, future: Future[Outcome]) -> Outcome:
    if (error := future.exception()) is None:
        return future.result()
    return Outcome(task.name, number, {}, f"was lost: {type(error).__name__}: {first_line(error)}")


def first_line(error: BaseException) -> str:
    """What an exception says, without its traceback."""
    said = str(error).strip().splitlines()
    return said[0] if said else "no reason given"

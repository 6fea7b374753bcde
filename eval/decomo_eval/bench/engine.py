"""Where attempts run, and which task is next: the order and the retries are the same on every engine."""

from __future__ import annotations

import logging
import os
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, replace
from typing import Protocol

from decomo_eval.bench.task import Outcome, Task
from decomo_eval.dataset import Video
from decomo_eval.errors import DatasetError

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Room:
    """Room for attempts, while the engine runs."""

    jobs: int
    """Attempts at a time."""
    submit: Callable[[Task, int], Future[Outcome]]
    """Starts an attempt of a task, by its number from 1. An exception of the future's is an attempt that was lost."""


class Engine(Protocol):
    """Runs attempts somewhere."""

    def start(self) -> AbstractContextManager[Room]:
        """Left before all is done, it starts nothing more. Raises `EvalError` where it cannot run tasks."""
        ...


@dataclass(frozen=True)
class LocalEngine:
    """Attempts on this machine, `jobs` at a time, which share its cores."""

    jobs: int = 1
    threads: int | None = None
    """Of each attempt. Default: an equal share of the cores."""

    @contextmanager
    def start(self) -> Iterator[Room]:
        """Waits in the end for what runs."""
        threads = self.threads or max(1, (os.cpu_count() or 1) // self.jobs)
        pool = ThreadPoolExecutor(self.jobs, thread_name_prefix="decomo-bench")
        try:
            yield Room(self.jobs, lambda task, number: pool.submit(task.attempt, number, threads))
        finally:
            pool.shutdown(cancel_futures=True)


def run_tasks(tasks: Sequence[Task], videos: Mapping[str, Video], room: Room) -> Iterator[Outcome]:
    """Runs the tasks; yields the last outcome of each, as they come. Reads one video at a time.

    A task whose attempt fails or is lost goes to the end of the queue, `Task.attempts` times at most; the others go on.
    """
    queue = deque((task, 1) for task in tasks)
    running: dict[Future[Outcome], tuple[Task, int]] = {}
    clips: dict[str, str] = {}
    while queue or running:
        while queue and len(running) < room.jobs:
            task, number = queue.popleft()
            if outcome := _without_attempt(task, videos, clips):
                yield outcome
            else:
                running[room.submit(task, number)] = task, number
        for future in wait(running, return_when=FIRST_COMPLETED).done:
            task, number = running.pop(future)
            outcome = replace(_outcome(task, number, future), jobs=room.jobs, clip=clips[task.name])
            if task.model.is_file():  # also where an attempt was lost, or given up for lost, and came to its end
                outcome = replace(outcome, error=None)
            task.record(outcome)
            if outcome.error is None or number == task.attempts:
                yield outcome
            else:
                logger.info("%s, attempt %d of %d: %s", task.name, number, task.attempts, outcome.error)
                queue.append((task, number + 1))


def _without_attempt(task: Task, videos: Mapping[str, Video], clips: dict[str, str]) -> Outcome | None:
    """The outcome of a task that needs no attempt, or can have none; else its frames are written.

    `clips` gets the video's digest.
    """
    finished = task.finished_before()
    try:
        video = videos[task.name]
        clips[task.name] = video.digest()
        if finished is None:
            task.prepare(video)
            return None
    except (DatasetError, OSError) as error:  # of one video: the others go on
        if finished is not None:
            return finished
        failed = Outcome(task.name, 1, {}, str(error))
        with suppress(OSError):
            task.record(failed)
        return failed
    if finished.clip in (None, clips[task.name]):
        return finished
    why = f"{task.model} was fitted to other frames than the dataset's; move it away, or give another --out"
    return replace(finished, error=why)


def _outcome(task: Task, number: int, future: Future[Outcome]) -> Outcome:
    if (error := future.exception()) is None:
        return future.result()
    return Outcome(task.name, number, {}, f"was lost: {type(error).__name__}: {first_line(error)}")


def first_line(error: BaseException) -> str:
    """What an exception says, without its traceback."""
    said = str(error).strip().splitlines()
    return said[0] if said else "no reason given"

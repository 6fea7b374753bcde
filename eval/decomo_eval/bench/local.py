"""The local engine: tasks on this machine, some at a time."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed

from decomo_eval.bench.task import Outcome, Task
from decomo_eval.dataset import Video


def run_tasks(tasks: Sequence[Task], videos: Mapping[str, Video], jobs: int) -> Iterator[Outcome]:
    """Runs the tasks, `jobs` at a time, each in processes of its own; yields outcomes as they come.

    One video at a time is read. Left before its end, it starts no further task and waits for those that run.
    """
    reading = threading.Lock()

    def read(name: str) -> Video:
        with reading:
            return videos[name]

    pool = ThreadPoolExecutor(jobs, thread_name_prefix="decomo-bench")
    try:
        for finished in as_completed([pool.submit(task.run, read) for task in tasks]):
            yield finished.result()
    finally:
        pool.shutdown(cancel_futures=True)

"""The Ray engine: attempts on a cluster, or on a Ray of this machine alone; what they make lies in a shared folder."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from decomotion.errors import EngineError
from decomotion.jobs.engine import Room, first_line
from decomotion.jobs.task import Outcome, Place, Task

CONNECT_SECONDS = 10
"""After which an address counts as silent; Ray itself would try for minutes."""
ENVIRONMENT = {
    "RAY_process_group_cleanup_enabled": "true",  # with a worker that is killed, the fit that it started ends too
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_worker_niceness": "0",  # Ray's 15 leaves a fit little of its minutes beside other work
}
"""Of a Ray that is started here, where the user has not said otherwise."""


@dataclass(frozen=True)
class RayEngine:
    """Attempts as Ray tasks. Ray itself retries none: `engine.run_tasks` does, on whatever node has room."""

    address: str | None = None
    """As of `ray.init`: default RAY_ADDRESS, else `local`, a Ray of this machine that is started for this run."""
    cpus: int = 1
    """Of each attempt; also its threads."""
    gpus: float = 0.0
    """Of each attempt, which sees no other: whole, or a share of one GPU."""
    jobs: int | None = None
    """Attempts at a time. Default: as many as the cluster has room for now; more lets one that can grow do so."""

    def __post_init__(self) -> None:
        if self.gpus < 0 or (self.gpus > 1 and self.gpus % 1):
            raise EngineError(f"a task reserves whole GPUs, or a share of one, not {self.gpus:g}")

    @contextmanager
    def start(self) -> Iterator[Room]:
        """Connects, or starts Ray; in the end what still runs for this batch is stopped.

        Raises `EngineError` where Ray is not installed, does not answer or has no room for one attempt.
        """
        with _environment():
            ray = _ray()
            address = self.address or os.environ.get("RAY_ADDRESS") or "local"
            try:
                _check_answers(address)
                ray.init(address=address, include_dashboard=False, log_to_driver=False, logging_level="warning")
            except Exception as error:  # Ray raises bare ones too
                raise EngineError(
                    f"Ray does not answer at {address} ({first_line(error)}); start it, or set RAY_AUTH_MODE=token if "
                    "it asks for a token"
                ) from error
            try:
                remote = ray.remote(num_cpus=self.cpus, num_gpus=self.gpus, max_retries=0)(_attempt)

                def submit(task: Task, number: int) -> Future[Outcome]:
                    return remote.remote(task, number, self.cpus, self.gpus > 0).future()

                def fit() -> int:
                    return self._fit(ray.nodes())

                yield Room(self.jobs or self._room(fit()), submit, fit)
            finally:
                ray.shutdown()

    def _fit(self, nodes: list[dict[str, Any]]) -> int:
        """How many attempts fit onto the nodes."""
        resources = [node["Resources"] for node in nodes if node["Alive"]]
        asked = {"CPU": self.cpus, "GPU": self.gpus}
        return sum(
            min(int(has.get(kind, 0) / number + 1e-6) for kind, number in asked.items() if number) for has in resources
        )

    def _room(self, fit: int) -> int:
        """How many are submitted, where so many fit. Raises `EngineError` where none does."""
        if not fit:
            raise EngineError(
                f"no node of the Ray cluster has {self.cpus} CPUs and {self.gpus:g} GPUs; ask for less, or give --jobs "
                "if the cluster grows on demand"
            )
        return fit


def _check_answers(address: str) -> None:
    """Raises `OSError` or `ValueError` where the address names a machine that does not answer."""
    if address not in ("auto", "local"):
        host, _, port = address.removeprefix("ray://").rpartition(":")
        socket.create_connection((host.strip("[]"), int(port)), CONNECT_SECONDS).close()


def _attempt(task: Task, number: int, threads: int, on_gpu: bool) -> Outcome:
    # Ray hides what others reserve from those only that reserve some themselves
    return task.attempt(number, Place(threads, {} if on_gpu else {"CUDA_VISIBLE_DEVICES": ""}))


@contextmanager
def _environment() -> Iterator[None]:
    """This process's, with `ENVIRONMENT` where it says nothing else, until the block is left."""
    added = {name: value for name, value in ENVIRONMENT.items() if name not in os.environ}
    os.environ.update(added)
    try:
        yield
    finally:
        for name in added:
            os.environ.pop(name, None)


def _ray() -> Any:
    try:
        import ray
    except ModuleNotFoundError as error:
        raise EngineError("--engine ray needs Ray; run: pip install 'decomotion[ray]'") from error
    return ray

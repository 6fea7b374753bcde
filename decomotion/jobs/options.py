"""Options of commands whose tasks run on an engine."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import click

from decomotion.jobs.engine import Engine, LocalEngine

ENGINES = LOCAL, RAY = "local", "ray"
"""Where tasks run: this machine, or a Ray cluster."""

ENGINE_OPTIONS = ("engine", "address", "jobs", "cpus_per_task", "gpus_per_task")
"""Names of the arguments that a command gets."""

Function = TypeVar("Function", bound=Callable[..., Any])


def engine_options(tasks: str) -> Callable[[Function], Function]:
    """Adds the options to a command whose tasks are called so; it gets them as the arguments of `chosen_engine`."""
    each, several = tasks.removesuffix("s"), tasks.capitalize()
    options = (
        click.option("--engine", type=click.Choice(ENGINES), default=LOCAL, help="This machine, or Ray."),
        click.option("--address", help="Of a Ray cluster.  [default: RAY_ADDRESS, else local, a new one]"),
        click.option(
            "--jobs", type=click.IntRange(min=1), help=f"{several} at a time.  [default: 1; of ray, what has room]"
        ),
        click.option(
            "--cpus-per-task",
            type=click.IntRange(min=1),
            help=f"Threads of each {each}, and CPUs that ray reserves.  [default: the cores by --jobs; of ray, 1]",
        ),
        click.option(
            "--gpus-per-task", type=click.FloatRange(min=0), help="GPUs that ray reserves, 0.5: a share.  [default: 0]"
        ),
    )

    def added(command: Function) -> Function:
        for option in reversed(options):
            command = option(command)
        return command

    return added


def chosen_engine(
    engine: str, address: str | None, jobs: int | None, cpus_per_task: int | None, gpus_per_task: float | None
) -> Engine:
    """The engine that the options name. Raises `click.UsageError` where they do not go together."""
    if engine == RAY:
        from decomotion.jobs.cluster import RayEngine

        return RayEngine(address, cpus_per_task or 1, float(gpus_per_task or 0), jobs)
    if address is not None or gpus_per_task is not None:
        raise click.UsageError("--address and --gpus-per-task are for --engine ray")
    return LocalEngine(jobs or 1, cpus_per_task)

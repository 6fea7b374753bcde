"""What a second worker is worth: one benchmark fitted by one, then by two, each from nothing, on one machine.

    python benchmarks/workers.py ../shared/data/tapvid_davis32_dev.pkl --time-budget 1m \
        --json benchmarks/results/workers.json

A fit with a budget of time ends after it however little it has done: wall time says how many videos an hour, steps and
AJ what was lost on each. About half an hour for ten clips at a minute; nothing else may run.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import click

from decomo_eval.bench.run import bench, command_options
from decomotion import checkpoint
from decomotion.console import run
from decomotion.jobs.cluster import RayEngine
from decomotion.jobs.engine import LocalEngine
from decomotion.jobs.options import ENGINES
from harness.records import Record, provenance, write_record

WORKERS = (1, 2)


def measure(dataset: Path, engine: LocalEngine | RayEngine, options: Sequence[str], names: list[str] | None) -> Record:
    """Wall seconds, steps and mean scores of one run; its supervision is prepared anew."""
    with tempfile.TemporaryDirectory(prefix="decomotion-workers-") as folder:
        os.environ["DECOMO_CACHE"] = f"{folder}/cache"
        begin = time.monotonic()
        summary = bench(dataset, folder, options, engine=engine, videos=names, attempts=1)
        seconds = time.monotonic() - begin
        if summary.failed or summary.report is None:
            raise click.ClickException(f"not all videos were fitted: {[each.error for each in summary.failed]}")
        runs = [Path(folder, "videos", each.name, "run", checkpoint.FILE_NAME) for each in summary.finished]
        steps = sum(checkpoint.load(file).training["step"] for file in runs)
        return {
            "seconds": round(seconds, 1),
            "seconds_per_video": summary.seconds_per_video,
            "steps_per_video": round(steps / len(runs)),
            "videos": len(runs),
            "mean": dict(summary.report.mean),
        }


@click.command(context_settings={"show_default": True})
@click.argument("dataset", type=click.Path(exists=True, path_type=Path))
@click.option("--time-budget", default="1m", help="Of each fit.")
@click.option("--preset", default="cpu")
@click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE")
@click.option("--videos", help="Names, separated by commas.  [default: all]")
@click.option("--engine", type=click.Choice(ENGINES), default=ENGINES[0])
@click.option("--json", "record_path", type=click.Path(path_type=Path), help="Write the record there.")
def main(
    dataset: Path,
    time_budget: str,
    preset: str,
    overrides: tuple[str, ...],
    videos: str | None,
    engine: str,
    record_path: Path | None,
) -> None:
    """Fit the videos of DATASET with one worker and with two, which share the cores."""
    options, about = command_options(preset, time_budget, None, 0, overrides), provenance()
    cores, by_workers = os.cpu_count() or 1, {}
    for number in WORKERS:
        share = max(1, cores // number)
        where = LocalEngine(number) if engine == ENGINES[0] else RayEngine("local", cpus=share, jobs=number)
        by_workers[number] = measure(dataset, where, options, videos.split(",") if videos else None)
    one, two = (by_workers[number] for number in WORKERS)
    record: Record = {
        "dataset": dataset.name,
        "engine": engine,
        "options": list(options),
        **about,
        "workers": by_workers,
        "speed_up": round(one["seconds"] / two["seconds"], 2),
        "steps_share": round(two["steps_per_video"] / one["steps_per_video"], 2),
    }
    click.echo(json.dumps(record, indent=2))
    if record_path is not None:
        write_record(record_path, record)


if __name__ == "__main__":
    sys.exit(run(main))

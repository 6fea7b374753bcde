"""`decomo-train`: fits a model to a clip."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from dataclasses import fields
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from decomotion.console import interrupt_flag, run
from decomotion.jobs.options import ENGINE_OPTIONS, chosen_engine, engine_options
from decomotion.options import (
    Duration,
    Supervision,
    forwarded,
    given_names,
    prepared_option,
    seed_option,
    supervision_options,
    window_options,
)

if TYPE_CHECKING:
    from decomotion.clip import Clip
    from decomotion.config import Config

log = logging.getLogger(__name__)

CORRECTING = ("finished", "corrections")
CORRECTION_BUDGET = "1m"
"""Of a fit that follows corrections."""
MAY_CORRECT_WITH = (*CORRECTING, "out", "time_budget", "steps", "device")
"""Options that `--corrections` heeds."""
OF_THE_WHOLE = ("out", "time_budget", "steps", "shots", "window", "resume", "prepared", *CORRECTING, *ENGINE_OPTIONS)
"""Options that are not those of a window."""
MAY_RESUME_WITH = (*OF_THE_WHOLE, "device")
"""Options that `--resume` heeds."""


@click.command(context_settings={"show_default": True, "help_option_names": ["-h", "--help"]})
@click.argument("clip", type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path), help="Folder of the run.  [default: runs/<clip name>]")
@click.option(
    "--time-budget",
    type=Duration(),
    help="End after this much wall time, preparation included (30s, 10m, 1h); windows share it by their length.  "
    "[default: 10m; of several windows 10m for each of two, 8m of three, 6m of more, those that are fitted at a time "
    f"counted as one; {CORRECTION_BUDGET} with --corrections; with the preset paper none, but its steps]",
)
@click.option("--steps", type=click.IntRange(min=1), help="End after this many steps instead of a time.")
@supervision_options
@window_options
@engine_options("windows")
@click.option("--resume", is_flag=True, help="Continue the run in --out where it stopped.")
@click.option(
    "--corrections",
    type=click.Path(path_type=Path),
    metavar="CSV",
    help="Go on from the finished fit --run so that it agrees with these (docs/corrections.md), in a new run.  "
    "[default of --out: RUN-corrected]",
)
@click.option(
    "--run", "finished", type=click.Path(path_type=Path), help="Folder of the run to correct, which stays as it is."
)
@click.option("--rebuild-cache", is_flag=True, help="Prepare the clip's supervision anew.")
@prepared_option
@seed_option
@click.option("--device", default="auto", help="auto, cpu, cuda or cuda:N.")
@click.pass_context
def command(
    context: click.Context,
    clip: Path,
    out: Path | None,
    time_budget: float | None,
    steps: int | None,
    shots: str,
    window: int | str,
    resume: bool,
    corrections: Path | None,
    finished: Path | None,
    rebuild_cache: bool,
    prepared: str,
    seed: int,
    device: str,
    **options: Any,
) -> None:
    """Fit a model to CLIP, a folder of frames or a video file; CLIP@A:B takes frames A up to but without B.

    A long clip is fitted as several windows, one after the other or --jobs at a time. The same command, or --resume,
    goes on with those that are not finished.
    """
    from decomotion.clip import read_clip
    from decomotion.errors import ConfigError
    from decomotion.outputs import check_folder

    engine_choice = {name: options.pop(name) for name in ENGINE_OPTIONS}
    supervision = Supervision(**options)
    if time_budget is not None and steps is not None:
        raise ConfigError("give --time-budget or --steps, not both")
    if (finished is None) != (corrections is None):
        raise ConfigError("--run and --corrections go together: the run to correct, and what to correct in it")
    if finished is not None and corrections is not None:
        if decided := given_names(context, MAY_CORRECT_WITH):
            raise ConfigError(f"a correction goes on with the run's own configuration; leave out {', '.join(decided)}")
        _correct(clip, finished, corrections, out, time_budget, steps, device)
        return
    frames = read_clip(clip)
    folder = out if out is not None else Path("runs") / frames.name
    check_folder("--out", folder)

    from decomotion.default_time import PRESETS_IN_TIME, announcement, default_seconds
    from decomotion.long_clip import check_no_files, fit_windows, lay_out, read_windows
    from decomotion.record import check_resumable
    from decomotion.windows import FILE_NAME

    decided, passed_on = given_names(context, MAY_RESUME_WITH), forwarded(context, OF_THE_WHOLE)
    how = {"steps": steps, "resume": resume, "rebuild_cache": rebuild_cache, "seed": seed, "device": device}
    goes_on = resume and (folder / FILE_NAME).is_file()
    if resume:
        check_resumable(folder)
    if resume and not goes_on:
        if decided and not _are_the_runs(folder, supervision.config(), seed, rebuild_cache):
            raise ConfigError(_resume_refused(decided))
        _fit_one(frames, folder, prepared=prepared, time_budget=time_budget, **how)
        return
    if goes_on:
        layout, _, begun_with = read_windows(folder)
        if passed_on and passed_on != begun_with:
            raise ConfigError(_resume_refused(decided))
        passed_on, config = begun_with, _config_of(begun_with)
    else:
        config, layout = supervision.config(), lay_out(frames, window, shots)
    in_time = config.preset in PRESETS_IN_TIME
    if not goes_on and len(layout.windows) == 1:
        seconds = default_seconds(1, 1) if in_time and steps is None and time_budget is None else time_budget
        log.info("%s", announcement(layout, 1, steps, seconds))
        _fit_one(frames, folder, prepared=prepared, config=config, time_budget=seconds, **how)
        return
    check_no_files(config.data)

    def announce(jobs: int, seconds: float | None) -> None:
        log.info("%s", announcement(layout, jobs, steps, seconds))

    longer = resume and (steps is not None or time_budget is not None)
    given = {"steps": steps, "time_budget": time_budget, "in_time": in_time, "longer": longer, "prepared": prepared}
    fit_windows(clip, frames, layout, folder, passed_on, engine=chosen_engine(**engine_choice), told=announce, **given)
    click.echo(
        f"fitted {frames.name} ({len(frames)} frames of {frames.width}x{frames.height}) in {len(layout.windows)} "
        f"windows: {folder}"
    )


def _config_of(options: Sequence[str]) -> Config:
    """That of a window which was begun with these options."""
    chosen = command.make_context("decomo-train", ["-", *options]).params
    return Supervision(**{each.name: chosen[each.name] for each in fields(Supervision)}).config()


def _fit_one(frames: Clip, folder: Path, *, device: str, prepared: str, **how: Any) -> None:
    from decomotion.cache import DROP, cache_root
    from decomotion.data.stages import remove_all
    from decomotion.device import choose_device
    from decomotion.memory import kept_memory
    from decomotion.train import fit

    device = choose_device(device)
    with kept_memory():
        fit(frames, folder, device=device, ignore_cuts=True, stopping=interrupt_flag, **how)
    if prepared == DROP:
        remove_all(cache_root() / frames.digest())
    click.echo(f"fitted {frames.name} ({len(frames)} frames of {frames.width}x{frames.height}): {folder}")


def _correct(
    clip: Path,
    finished: Path,
    corrections: Path,
    out: Path | None,
    time_budget: float | None,
    steps: int | None,
    device: str,
) -> None:
    from decomotion.clip import read_clip
    from decomotion.corrections.file import read_corrections
    from decomotion.outputs import check_new_folder

    folder = out if out is not None else _beside(finished)
    check_new_folder("--out", folder)
    frames = read_clip(clip)
    points = read_corrections(corrections, frames)

    from decomotion.corrections.fit import correct
    from decomotion.memory import kept_memory
    from decomotion.schedule import Budget

    seconds = time_budget if steps is not None or time_budget else Duration().convert(CORRECTION_BUDGET, None, None)
    budget = Budget(steps or 1, seconds)
    with kept_memory():
        correct(frames, finished, corrections, points, folder, budget=budget, device=device, stopping=interrupt_flag)
    click.echo(f"corrected {len(points)} point{'s' * (len(points) > 1)} of {frames.name}: {finished}")
    click.echo(f"wrote {folder}")


def _beside(finished: Path) -> Path:
    """A folder beside that of a run, which is not there yet."""
    run = finished if finished.name not in ("", "..") else finished.resolve()
    name = f"{run.name}-corrected"
    names = chain([name], (f"{name}-{number}" for number in count(2)))
    return next(folder for folder in map(run.with_name, names) if not folder.exists())


def _are_the_runs(folder: Path, config: Config, seed: int, rebuild_cache: bool) -> bool:
    """Whether the run in `folder` was begun with these."""
    from decomotion.record import read_record

    found = read_record(folder)
    return not rebuild_cache and found is not None and found.is_like(config, seed)


def _resume_refused(decided: Sequence[str]) -> str:
    return f"--resume continues with the run's own configuration and seed; leave out {', '.join(decided)}"


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    return run(command, argv)


if __name__ == "__main__":
    sys.exit(main())

"""`decomo-train`: fits a model to a clip."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from decomotion.console import interrupt_flag, run
from decomotion.options import Duration, Supervision, seed_option, supervision_options

DEFAULT_BUDGET = "10m"
"""Of each shot, where a clip has several."""
MINUTES = ("cpu", "omnimotion")
"""Presets that have a default budget in minutes, not in steps."""
MAY_RESUME_WITH = ("out", "time_budget", "steps", "shots", "resume", "device")
"""Options that `--resume` heeds."""


@click.command(context_settings={"show_default": True, "help_option_names": ["-h", "--help"]})
@click.argument("clip", type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path), help="Folder of the run.  [default: runs/<clip name>]")
@click.option(
    "--time-budget",
    type=Duration(),
    help="End after this much wall time, preparation included (30s, 10m, 1h); shots share it by their length.  "
    f"[default: {DEFAULT_BUDGET} with the cpu preset and omnimotion, for each shot; none with paper]",
)
@click.option("--steps", type=click.IntRange(min=1), help="End after this many steps instead of a time.")
@supervision_options
@click.option(
    "--shots",
    type=click.Choice(["stop", "split", "ignore"]),
    default="stop",
    help="Where the clip cuts to another shot: stop and say where, fit one model to each shot, or fit across.",
)
@click.option("--resume", is_flag=True, help="Continue the run in --out where it stopped.")
@click.option("--rebuild-cache", is_flag=True, help="Prepare the clip's supervision anew.")
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
    resume: bool,
    rebuild_cache: bool,
    seed: int,
    device: str,
    **options: Any,
) -> None:
    """Fit a model to CLIP, a folder of frames or a video file; CLIP@A:B takes frames A up to but without B."""
    from decomotion.clip import Clip, read_clip
    from decomotion.errors import ConfigError
    from decomotion.outputs import check_folder

    supervision = Supervision(**options)
    if time_budget is not None and steps is not None:
        raise ConfigError("give --time-budget or --steps, not both")
    if resume and (decided := _given(context, MAY_RESUME_WITH)):
        raise ConfigError(
            f"--resume continues with the run's own configuration and seed; leave out {', '.join(decided)}"
        )
    frames = read_clip(clip)
    folder = out if out is not None else Path("runs") / frames.name
    check_folder("--out", folder)

    from decomotion import checkpoint
    from decomotion.device import choose_device
    from decomotion.memory import kept_memory
    from decomotion.shots import check_no_files, each_shot
    from decomotion.train import fit

    device = choose_device(device)
    config = None if resume else supervision.config()
    default, seconds_each = Duration().convert(DEFAULT_BUDGET, None, None), None
    if config is not None and config.preset in MINUTES and time_budget is None and steps is None:
        seconds_each = default
    if config is not None and shots == "split":
        check_no_files(config.data)

    def fit_one(part: Clip, folder: Path, share: float = 1.0) -> Path:
        with kept_memory():
            fit(
                part,
                folder,
                config=config,
                steps=steps,
                time_budget=seconds_each if time_budget is None else share * time_budget,
                resume=resume and (shots != "split" or (folder / checkpoint.FILE_NAME).is_file()),
                rebuild_cache=rebuild_cache,
                seed=seed,
                device=device,
                ignore_cuts=shots != "stop",
                stopping=interrupt_flag,
            )
        click.echo(f"fitted {part.name} ({len(part)} frames of {part.width}x{part.height}): {folder}")
        return folder

    if shots != "split":
        fit_one(frames, folder)
        return
    if resume:  # shots that were not begun follow the first
        first = checkpoint.load(folder / "shot-000" / checkpoint.FILE_NAME)
        config, seed = first.config, first.training["seed"]
        if steps is None and time_budget is None:
            steps, seconds = first.training["budget"]["steps"], first.training["budget"]["seconds"]
            if seconds == default:
                seconds_each = default
            elif seconds is not None:
                time_budget = seconds * len(frames) / first.clip.num_frames
    each_shot(frames, folder, fit_one)


def _given(context: click.Context, but_for: Sequence[str]) -> list[str]:
    """The options on the command line, without those named `but_for`."""
    options = [each for each in context.command.params if isinstance(each, click.Option) and each.name not in but_for]
    return [
        each.opts[0]
        for each in options
        if each.name is not None and context.get_parameter_source(each.name) is ParameterSource.COMMANDLINE
    ]


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    return run(command, argv)


if __name__ == "__main__":
    sys.exit(main())

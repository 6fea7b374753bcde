"""`decomo-train`: fits a model to a clip."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from pathlib import Path

import click

from decomotion.console import run


class Duration(click.ParamType):
    """Seconds from text such as `90`, `90s`, `10m` or `1.5h`."""

    name = "duration"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Parses; a number that is already one passes."""
        if isinstance(value, (int, float)):
            return float(value)
        match = re.fullmatch(r"(\d+(?:\.\d+)?)([smh]?)", str(value).strip())
        if match is None or float(match[1]) <= 0:
            self.fail(f"{value!r} is not a duration; write for example 90s, 10m or 1.5h", param, ctx)
        return float(match[1]) * {"": 1, "s": 1, "m": 60, "h": 3600}[match[2]]


DEFAULT_BUDGET = "10m"
MINUTES = ("cpu", "omnimotion")
"""Presets that have a default budget in minutes, not in steps."""


@click.command(context_settings={"show_default": True, "help_option_names": ["-h", "--help"]})
@click.argument("clip", type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path), help="Folder of the run.  [default: runs/<clip name>]")
@click.option(
    "--preset",
    type=click.Choice(["auto", "cpu", "omnimotion", "paper"]),
    default="auto",
    help="Sizes, losses and schedules; auto: paper where there is a CUDA device, else cpu.",
)
@click.option(
    "--time-budget",
    type=Duration(),
    help=f"End after this much wall time, preparation included (30s, 10m, 1h).  [default: {DEFAULT_BUDGET} with the "
    "cpu preset and omnimotion, none with paper]",
)
@click.option("--steps", type=click.IntRange(min=1), help="End after this many steps instead of a time.")
@click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Override one configuration value.")
@click.option("--config", "file", type=click.Path(path_type=Path), help="YAML file to use in place of a preset.")
@click.option("--masks", help="Motion masks: auto, none, or a folder of images.  [default: the preset's]")
@click.option("--resume", is_flag=True, help="Continue the run in --out where it stopped.")
@click.option("--rebuild-cache", is_flag=True, help="Prepare the clip's supervision anew.")
@click.option("--seed", type=click.IntRange(min=0, max=2**31 - 1), default=0, help="Seed of everything random.")
@click.option("--device", default="auto", help="auto, cpu, cuda or cuda:N.")
def command(
    clip: Path,
    out: Path | None,
    preset: str,
    time_budget: float | None,
    steps: int | None,
    overrides: tuple[str, ...],
    file: Path | None,
    masks: str | None,
    resume: bool,
    rebuild_cache: bool,
    seed: int,
    device: str,
) -> None:
    """Fit a model to CLIP, a folder of frames or a video file."""
    from decomotion import config as configuration
    from decomotion.clip import read_clip
    from decomotion.errors import ConfigError

    if time_budget is not None and steps is not None:
        raise ConfigError("give --time-budget or --steps, not both")
    if resume and (overrides or file or masks):
        raise ConfigError("--resume continues with the run's own configuration; leave out --set, --config and --masks")
    frames = read_clip(clip)

    from decomotion.train import choose_device, fit

    device = choose_device(device)
    name = preset if preset != "auto" else "paper" if device.startswith("cuda") else "cpu"
    if masks is not None:
        overrides = (*overrides, f"data.masks={masks}")
    config = None if resume else configuration.load(name, file, overrides)
    if config is not None and config.preset in MINUTES and time_budget is None and steps is None:
        time_budget = Duration().convert(DEFAULT_BUDGET, None, None)
    folder = fit(
        frames,
        out,
        config=config,
        steps=steps,
        time_budget=time_budget,
        resume=resume,
        rebuild_cache=rebuild_cache,
        seed=seed,
        device=device,
    )
    click.echo(f"fitted {frames.name} ({len(frames)} frames of {frames.width}x{frames.height}): {folder}")


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    return run(command, argv)


if __name__ == "__main__":
    sys.exit(main())

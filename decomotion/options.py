"""Options that `decomo-train` and `decomo-prepare` share: what decides the supervision of a clip."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click
from click.core import ParameterSource

from decomotion.cache import FEW, PREPARED
from decomotion.errors import ConfigError
from decomotion.presets import AUTO, AUTO_PRESET, PRESETS

if TYPE_CHECKING:
    from decomotion.config import Config

Function = TypeVar("Function", bound=Callable[..., Any])

WHOLE = "all"
"""A window that is the whole clip."""


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


class WindowLength(click.ParamType):
    """Frames of a window: a number, `auto` or `all`."""

    name = "auto|all|N"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> object:
        """Parses; what is already a number passes."""
        from decomotion.windows import SHORTEST

        if value in (AUTO, WHOLE) or isinstance(value, int):
            return value
        if not str(value).isdecimal() or int(str(value)) < SHORTEST:
            self.fail(f"{value!r} is neither {AUTO}, {WHOLE} nor a number of frames from {SHORTEST} on", param, ctx)
        return int(str(value))


@dataclass(frozen=True)
class Supervision:
    """What the user said about the configuration; None: as the preset has it."""

    preset: str
    overrides: tuple[str, ...]
    file: Path | None
    flow: str | None
    flow_weights: str | None
    matches: str | None
    match_weights: tuple[str, ...]
    features: str | None
    feature_weights: str | None
    masks: str | None
    tracks: str | None
    prepare_budget: float | None

    def config(self) -> Config:
        """The resolved configuration."""
        from decomotion import config as configuration

        name = AUTO_PRESET if self.preset == AUTO else self.preset
        chosen = {
            "data.matching.kind": self.matches,
            "data.matching.weights": list(self.match_weights) or None,
            "data.features": self.features,
            "data.feature_weights": self.feature_weights,
            "data.masks": self.masks,
            "data.tracks": self.tracks,
            "data.prepare_budget": self.prepare_budget,
            "data.flow.weights": self.flow_weights,
        }
        overrides = tuple(f"{key}={json.dumps(value)}" for key, value in chosen.items() if value is not None)
        try:
            return configuration.load(name, self.file, (*overrides, *self.overrides), flow=self.flow)
        except ConfigError as error:
            if self.flow_weights is not None and "there is no key data.flow.weights" in str(error):
                raise ConfigError("--flow-weights goes with --flow raft-small or raft-large") from error
            raise


SUPERVISION_OPTIONS = (
    click.option(
        "--preset",
        type=click.Choice([AUTO, *PRESETS]),
        default=AUTO,
        help=f"Sizes, losses and schedules; {AUTO}: {AUTO_PRESET}.",
    ),
    click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Override one configuration value."),
    click.option("--config", "file", type=click.Path(path_type=Path), help="YAML file to use in place of a preset."),
    click.option(
        "--flow",
        metavar="dis|raft-small|raft-large|DIR",
        help="Optical flow, or a folder of fields <i>_<j>.flo or .npy.  [default: the preset's]",
    ),
    click.option("--flow-weights", metavar="FILE", help="Weights of RAFT, torchvision's or the original's."),
    click.option(
        "--matches",
        type=click.Choice(["sift", "xfeat", "aliked"]),
        help="Matches by appearance, for what flow loses: dense SIFT or LightGlue's.  [default: the preset's]",
    ),
    click.option(
        "--match-weights",
        metavar="FILE",
        multiple=True,
        help="Weights of XFeat or ALIKED, and of its LightGlue: given twice where these are two files.",
    ),
    click.option(
        "--features",
        type=click.Choice(["densesift", "aliked", "dino", "none"]),
        help="Dense features to render.  [default: the preset's]",
    ),
    click.option("--feature-weights", metavar="FILE", help="Weights of ALIKED or DINO."),
    click.option(
        "--masks",
        metavar="auto|isnet|FILE.onnx|none|DIR",
        help="What moves: by links; with outlines by IS-Net, or its file; not at all; or a folder of masks.  [default: "
        "the preset's]",
    ),
    click.option("--tracks", metavar="FILE", help="Tracks of any tracker, .npz, as further correspondences."),
    click.option(
        "--prepare-budget",
        type=Duration(),
        help="Time that preparation should take at most, in a fit no more than three quarters of its --time-budget: "
        "thins the gaps at which flow is computed, and the points.  [default: the preset's]",
    ),
)


seed_option = click.option(
    "--seed", type=click.IntRange(min=0, max=2**31 - 1), default=0, help="Seed of everything random."
)


prepared_option = click.option(
    "--prepared",
    type=click.Choice(PREPARED),
    default=AUTO,
    help=f"Keep or drop what a fit has prepared, in the cache, when it is finished. {AUTO}: dropped where more than "
    f"{FEW} clips, or windows of one, are fitted.",
)


def supervision_options(command: Function) -> Function:
    """Adds the options to a command, which gets their values as the keyword arguments of `Supervision`."""
    for option in reversed(SUPERVISION_OPTIONS):
        command = option(command)
    return command


def window_options(command: Function) -> Function:
    """Adds `shots` and `window` to a command: what a clip is cut into (`decomotion.long_clip.lay_out`)."""
    shots = click.option(
        "--shots",
        type=click.Choice(["stop", "split", "ignore"]),
        default="stop",
        help="Where the clip cuts to another shot: stop and say where, begin a new window, or go on across.",
    )
    window = click.option(
        "--window",
        type=WindowLength(),
        default=AUTO,
        metavar=WindowLength.name,
        help=f"Frames that are fitted as one; a longer clip becomes windows that overlap. {AUTO}: 100, of a clip of "
        f"more than 128; {WHOLE}: the whole clip.",
    )
    return shots(window(command))


FILES = ("file", "flow_weights", "match_weights", "feature_weights", "tracks")
"""Arguments that name files, which commands elsewhere find by their full names."""
PERHAPS_FILES = ("flow", "masks")
"""Arguments that name a file or a folder, or something else."""


def forwarded(context: click.Context, but_for: Sequence[str], base: Path | None = None) -> list[str]:
    """The options that a command was given, without those called `but_for`, as arguments of another.

    Files get their full names, from the folder `base` on; default: the working directory.
    """
    base = Path.cwd() if base is None else base.absolute()
    arguments = []
    for option in _given(context, but_for):
        value = context.params[option.name or ""]
        for each in value if option.multiple else [value]:
            text = str(each)
            if option.name in FILES or (option.name in PERHAPS_FILES and (base / text).exists()):
                text = str(base / text)
            arguments += [option.opts[0]] if option.is_flag else [option.opts[0], text]
    return arguments


def given_names(context: click.Context, but_for: Sequence[str] = ()) -> list[str]:
    """The names of the options that a command was given, without the arguments called `but_for`."""
    return [option.opts[0] for option in _given(context, but_for)]


def _given(context: click.Context, but_for: Sequence[str]) -> list[click.Option]:
    return [
        each
        for each in context.command.params
        if isinstance(each, click.Option)
        and each.name not in (None, *but_for)
        and context.get_parameter_source(each.name or "") is ParameterSource.COMMANDLINE
    ]

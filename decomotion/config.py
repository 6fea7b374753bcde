"""The configuration: one typed tree from one YAML file. Unknown keys stop the load, by name.

Each leaf stands beside the code that reads it; this is where they come together. A file is completed before it is
checked: `extends` names the preset that it differs from, and what a flow estimator has of its own comes from
`configs/flow/<kind>.yaml` where the file does not say.
"""

from __future__ import annotations

from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from deepmerge import STRATEGY_END, Merger
from pydantic import Field, ValidationError

from decomotion import plain_yaml
from decomotion.data.config import DataConfig
from decomotion.data.flow.config import ESTIMATORS, FlowConfig
from decomotion.errors import ConfigError
from decomotion.leaf import Leaf
from decomotion.model.config import ModelConfig
from decomotion.presets import PRESETS
from decomotion.schedule import OptimConfig, Schedule

EXTENDS = "extends"
"""Key of a file that builds on a preset."""


class LogConfig(Leaf):
    """What a run records."""

    scalars_every: int = Field(ge=1)
    """Steps between TensorBoard scalars."""
    previews: int = Field(ge=0)
    """Preview pictures over a run."""
    checkpoint_seconds: float = Field(gt=0)
    """Time between checkpoints."""


class Config(Leaf):
    """Everything that decides a fit, apart from the clip, the seed and the budget."""

    preset: str
    """The name that the exported model carries."""
    data: DataConfig
    model: ModelConfig
    loss: dict[str, float | Schedule]
    """Weight of each loss by its name in `decomotion/losses`; 0 switches it off."""
    optim: OptimConfig
    log: LogConfig


def _of_another_kind(merger: Merger, path: list[str], base: dict[str, Any], changes: dict[str, Any]) -> Any:
    """A mapping of another `kind` takes the place of the former one whole."""
    del merger, path
    return changes if changes.get("kind", base.get("kind")) != base.get("kind") else STRATEGY_END


MERGER = Merger([(dict, [_of_another_kind, "merge"])], ["override"], ["override"])
"""Puts the second mapping's values into the first, mapping by mapping."""


def load(
    preset: str = "cpu",
    file: str | Path | None = None,
    overrides: tuple[str, ...] = (),
    flow: str | None = None,
) -> Config:
    """Reads a preset (or `file`, in the same form) and applies `overrides` of the form `a.b.c=value`.

    `flow` exchanges the estimator first: one of `ESTIMATORS`, with its own settings, or a folder of flow fields.

    Raises `ConfigError` naming the key that is unknown, missing or of the wrong type.
    """
    tree, source = _read(preset, file)
    if isinstance(tree.get("data"), dict) and isinstance(tree["data"].get("flow"), dict):
        tree["data"]["flow"] = _completed(tree["data"]["flow"], flow)
    for override in overrides:
        _apply(tree, override)
    return parse(tree, source)


def _read(preset: str, file: str | Path | None) -> tuple[dict[str, Any], str]:
    source = Path(file) if file is not None else _shipped(f"{preset}.yaml")
    if file is None and preset not in PRESETS:
        raise ConfigError(f"preset {preset!r} is unknown; choose one of {', '.join(PRESETS)}")
    if not source.is_file():
        raise ConfigError(f"config file {source} does not exist; copy one of decomotion/configs/ to start from")
    try:
        tree = plain_yaml.parse(source.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ConfigError(f"config file {source} is not YAML: {error}") from error
    if not isinstance(tree, dict):
        raise ConfigError(f"config file {source} does not hold a mapping of keys")
    if EXTENDS in tree:
        base, _ = _read(str(tree.pop(EXTENDS)), None)
        tree = MERGER.merge(base, tree)
    return tree, str(source)


def _shipped(name: str) -> Traversable:
    return files("decomotion") / "configs" / name


def _completed(given: dict[str, Any], flow: str | None) -> dict[str, Any]:
    """The settings of flow, those of the estimator `flow` where it is another, with what a file leaves to it."""
    if flow not in (None, "", given.get("kind")):
        common = {key: given[key] for key in FlowConfig.model_fields if key in given}
        given = {**common, **({"kind": flow} if flow in ESTIMATORS else {"kind": "folder", "path": flow})}
    if given.get("kind") not in ESTIMATORS:
        return given
    return {**plain_yaml.parse(_shipped(f"flow/{given['kind']}.yaml").read_text(encoding="utf-8")), **given}


def parse(tree: Any, source: str) -> Config:
    """The typed configuration of a plain mapping; `source` is what error messages call it."""
    try:
        return Config.model_validate(tree)
    except ValidationError as error:
        first = max(error.errors(), key=lambda each: len(each["loc"]))  # of a union, the form that was meant
        key = ".".join(_path_in(tree, first["loc"]))
        raise ConfigError(f"{source}: {key}: {first['msg'].lower()}; see decomotion/configs/ for the keys") from error


def _path_in(tree: Any, location: tuple[int | str, ...]) -> list[str]:
    """The keys that lead to an error's place: pydantic's location without the kinds of the leaves on the way."""
    path: list[str] = []
    for part in location:
        if isinstance(tree, dict) and part not in tree and part == tree.get("kind"):
            continue
        path.append(str(part))
        tree = tree.get(part) if isinstance(tree, dict) else None
    return path


def _apply(tree: dict[str, Any], override: str) -> None:
    key, equals, text = override.partition("=")
    path = key.strip().split(".")
    if not equals or not all(path):
        raise ConfigError(f"--set {override} is not of the form key=value, for example optim.steps=500")
    branch: Any = tree
    for depth, part in enumerate(path[:-1], start=1):
        if not isinstance(branch, dict) or part not in branch:
            raise ConfigError(f"--set {override}: there is no key {'.'.join(path[:depth])}")
        branch = branch[part]
    if not isinstance(branch, dict) or path[-1] not in branch:
        raise ConfigError(f"--set {override}: there is no key {key.strip()}")
    try:
        branch[path[-1]] = plain_yaml.parse(text)
    except ValueError as error:
        raise ConfigError(f"--set {override}: the value is not YAML") from error

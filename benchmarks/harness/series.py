"""Rows: what is run on which clips for how long, from the command line or from a YAML file in `benchmarks/series`.

defaults: {clips: [goat, dog], time_budget: 3m}     # of every row that does not say otherwise
rows:
  - {name: fused}
  - {name: static, overrides: [model.volumes=static]}
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from decomotion import config as configuration
from decomotion.config import Config


class Row(BaseModel):
    """One configuration, run on some clips with some seeds."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)

    name: str = Field(pattern=r"^[\w.+-]+$")
    """Names the folder of its records."""
    preset: str = "cpu"
    overrides: tuple[str, ...] = ()
    """`key=value`, as `decomo-train --set` takes them; `{clip}` stands for the clip's name."""
    clips: tuple[str, ...] | None = None
    """Default: all of the dataset."""
    seeds: tuple[int, ...] = (0,)
    time_budget: str | None = None
    """`90s`, `3m`: as `decomo-train --time-budget`; or"""
    steps: int | None = None
    """a number of steps, which a busy machine does not change."""
    rebuild_cache: bool = True
    """Prepare within the budget, as a user's first fit does; false: before it, once for all rows of equal `data`."""

    @model_validator(mode="after")
    def _one_budget(self) -> Row:
        if (self.time_budget is None) == (self.steps is None):
            raise ValueError("a row has either a time_budget or a number of steps")
        return self

    def on(self, clip: str) -> Row:
        """The row for one clip."""
        return self.model_copy(update={"overrides": tuple(part.replace("{clip}", clip) for part in self.overrides)})

    def config(self) -> Config:
        """The resolved configuration. Raises `decomotion.errors.ConfigError`."""
        return configuration.load(self.preset, overrides=self.overrides)

    def settings(self) -> dict[str, Any]:
        """What the row's records say of it, as JSON has it."""
        return self.model_dump(mode="json", include={"preset", "overrides", "time_budget", "steps", "rebuild_cache"})


class Series(BaseModel):
    """Rows to be compared with one another."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    rows: tuple[Row, ...]

    @model_validator(mode="after")
    def _distinct(self) -> Series:
        names = [row.name for row in self.rows]
        if len(set(names)) < len(names):
            raise ValueError("two rows have one name")
        return self


def read_series(path: Path) -> Series:
    """Reads a series file. Raises `click.UsageError` that names the row and key that are wrong."""
    try:
        tree = yaml.safe_load(path.read_text(encoding="utf-8"))
        rows = [{**tree.get("defaults", {}), **row} for row in tree["rows"]]
        return Series.model_validate({"rows": rows})
    except ValidationError as error:
        first = error.errors()[0]
        raise click.UsageError(f"{path}: {'.'.join(map(str, first['loc']))}: {first['msg'].lower()}") from error
    except (yaml.YAMLError, AttributeError, KeyError, TypeError) as error:
        raise click.UsageError(f"{path} is not a series: it needs `rows`, a list of mappings") from error

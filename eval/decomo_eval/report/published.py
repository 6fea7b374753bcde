"""Figures that others published (`published.yaml`), to be shown beside measured ones, never among them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from importlib.resources import files

from decomo_eval.columns import COLUMNS


@dataclass(frozen=True)
class Published:
    """A published table, for one query mode."""

    source: str
    url: str
    dataset: str
    rows: dict[str, dict[str, float]]
    """Metrics of each method in the units of `scoring.Report`; nan where the table has none."""


def published(query_mode: str) -> Published:
    """The paper's table of point tracking on TAP-Vid-DAVIS; methods without figures for `query_mode` left out."""
    import yaml

    content = yaml.safe_load((files("decomo_eval.report") / "published.yaml").read_text(encoding="utf-8"))
    factors = {column.metric: column.factor for column in COLUMNS}
    rows = {
        method: {
            metric: math.nan if value is None else value / factors[metric]
            for metric, value in zip(content["columns"], modes[query_mode], strict=True)
        }
        for method, modes in content["rows"].items()
        if query_mode in modes
    }
    return Published(content["source"], content["url"], content["dataset"], rows)

"""Options of more than one command, by what they say of a dataset."""

from __future__ import annotations

import click

from decomo_eval.names import DATASETS
from decomo_eval.query_mode import QUERY_MODES

dataset_option = click.option(
    "--dataset", "dataset_name", type=click.Choice(DATASETS), help="What DATASET is.  [default: its files tell]"
)
query_mode_option = click.option(
    "--query-mode",
    type=click.Choice(QUERY_MODES),
    help="Query every fifth frame, or each point where it is first visible.  "
    "[default: strided; first of other datasets than TAP-Vid's and your own]",
)


def listed(names: str | None) -> list[str] | None:
    """What is given as A,B, each once; None where nothing is."""
    return None if names is None else list(dict.fromkeys(name.strip() for name in names.split(",") if name.strip()))

"""How a model file came to be, as its metadata tell it."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from decomo_runtime import contract
from decomo_runtime.metadata import parsed_if_there


@dataclass(frozen=True)
class Origin:
    """How a model file came to be; None: the file, which may be older, does not say."""

    fitted_by: str | None = None
    """Version of the decomotion that fitted it, with its commit where that was known: `0.1.0+g0123456789ab`."""
    exported_by: str | None = None
    """Likewise of the one that wrote the file."""
    steps: int | None = None
    """That the fit took."""
    budget_steps: int | None = None
    """That it was allowed; None too where it was given time."""
    budget_seconds: float | None = None
    """That it was given, preparation included; None too where it was given steps."""
    bake: str | None = None
    """What is kept as tables: `none`, `depth` or `full`."""
    precision: str | None = None
    """Of the weights: `fp32`, `fp16` or `int8`."""
    deviation: tuple[float, float] | None = None
    """How far its tracks are from those in float32: mean and 99th percentile, pixels."""
    licence: str | None = None
    """Of the clip, as who exported the model gave it."""


def read_origin(metadata: Mapping[str, str], path: Path) -> Origin:
    """Of a file's metadata; `ModelFileError` where an entry is impossible."""
    budget = parsed_if_there(metadata, contract.META_BUDGET, path, _budget, lambda _: True) or (None, None)
    return Origin(
        fitted_by=metadata.get(contract.META_FITTED_BY),
        exported_by=metadata.get(contract.META_WRITER_VERSION),
        steps=parsed_if_there(metadata, contract.META_STEPS, path, int, lambda value: value >= 0),
        budget_steps=budget[0] if budget[1] is None else None,
        budget_seconds=budget[1],
        bake=metadata.get(contract.META_BAKE),
        precision=metadata.get(contract.META_PRECISION),
        deviation=parsed_if_there(
            metadata, contract.META_DEVIATION, path, _deviation, lambda two: all(0 <= each < math.inf for each in two)
        ),
        licence=metadata.get(contract.META_LICENCE),
    )


def _budget(text: str) -> tuple[int, float | None]:
    """Steps, and seconds or None."""
    content = json.loads(text)
    steps, seconds = int(content["steps"]), content.get("seconds")
    if steps < 0 or not (seconds is None or 0 <= float(seconds) < math.inf):
        raise ValueError
    return steps, None if seconds is None else float(seconds)


def _deviation(text: str) -> tuple[float, float]:
    mean, p99 = map(float, text.split())
    return mean, p99

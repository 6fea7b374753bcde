"""How numbers change over a run; `progress` runs from 0 to 1, in steps or in time."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from pydantic import Field

from decomotion.leaf import Leaf

MIN_SECONDS = 1.0
"""A run optimises for this long even where preparation has used up its time."""


class Schedule(Leaf):
    """A number that changes linearly over a part of the run."""

    value: float
    """Before `begin`."""
    to: float
    """After `end`."""
    begin: float = Field(ge=0, le=1)
    """Fraction of the run at which the change begins."""
    end: float = Field(ge=0, le=1)
    """Fraction of the run at which it is complete."""


class OptimConfig(Leaf):
    """The optimisation."""

    steps: int = Field(ge=1)
    """Optimisation steps where neither --steps nor --time-budget says otherwise."""
    pairs: int = Field(ge=1)
    """Frame pairs in a batch."""
    points: int = Field(ge=1)
    """Correspondences of each pair in a batch."""
    lr_field: float
    """Adam's learning rate of the fields."""
    lr_transform: float
    """Of the transforms."""
    lr_code: float
    """Of the frame codes."""
    warmup: float = Field(ge=0, le=1)
    """Fraction of the run over which the learning rates rise from zero."""
    decay: Literal["cosine", "step"]
    """How they fall: half a cosine to zero, or by `decay_factor` every `decay_every` of the run."""
    decay_every: float = Field(gt=0, le=1)
    decay_factor: float = Field(gt=0, le=1)
    gap: Schedule
    """Longest frame gap of a pair, as a fraction of the clip's length."""
    hard_mining: float = Field(ge=0, le=1)
    """Share of the correspondences that are drawn by their last known error."""
    smooth_share: float = Field(ge=0, le=1)
    """Share of the correspondences at which scene-flow smoothness is evaluated."""
    candidates: int = Field(ge=1)
    """Points drawn for each that a batch takes: those whose target is known are taken first."""
    moving_share: float = Field(ge=0, le=0.9)
    """Least share of the correspondences that is drawn from what moves; 0: as much as it covers."""
    hidden_share: float = Field(0.0, ge=0, le=0.5)
    """Share of the correspondences that is of points whose target is not known, where there are any; none in older
    runs.
    """
    count_maps: bool
    """Draw points that are linked to few frames more often (OmniMotion's count maps)."""
    micro_batch: int = Field(ge=0)
    """Pairs whose graph is held in memory at once (gradients are accumulated; the mathematics is the same); 0: all."""
    clip_norm: float = Field(gt=0)
    """Norm to which the whole model's gradient is cut where it is larger."""
    autocast: Literal["none", "bf16"]
    """Precision of the products of MLPs' hidden layers (`decomotion/model/precision.py`); all else is float32."""


@dataclass(frozen=True)
class Budget:
    """When a run is over: after `steps`, or after `seconds` of wall time, preparation included."""

    steps: int
    seconds: float | None = None

    def progress(self, step: int, elapsed: float, prepared: float) -> float:
        """Fraction of the optimisation that is done, `prepared` seconds of `elapsed` having gone to preparation."""
        if self.seconds is None:
            return step / self.steps
        return min(1.0, (elapsed - prepared) / max(self.seconds - prepared, MIN_SECONDS))


def value_at(schedule: float | Schedule, progress: float) -> float:
    """The scheduled number: constant, or linear between two points of the run."""
    if not isinstance(schedule, Schedule):
        return schedule
    if progress >= schedule.end:
        return schedule.to
    if progress <= schedule.begin:
        return schedule.value
    share = (progress - schedule.begin) / (schedule.end - schedule.begin)
    return schedule.value + share * (schedule.to - schedule.value)


def learning_rate_factor(config: OptimConfig, progress: float) -> float:
    """Factor on the learning rates: a linear warm-up, then a cosine to zero or steps."""
    if progress < config.warmup:
        return max(progress, 1e-3 * config.warmup) / config.warmup
    if config.decay == "step":
        return config.decay_factor ** math.floor(progress / config.decay_every)
    share = (progress - config.warmup) / max(1 - config.warmup, 1e-9)
    return 0.5 * (1 + math.cos(math.pi * min(share, 1.0)))


def longest_gap(config: OptimConfig, progress: float, num_frames: int) -> int:
    """Longest frame gap of a pair at this point of the run (OmniMotion's growing interval)."""
    return max(1, min(num_frames - 1, round(value_at(config.gap, progress) * (num_frames - 1))))

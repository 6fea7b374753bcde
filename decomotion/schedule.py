"""How numbers change over a run; `progress` runs from 0 to 1, in steps or in time."""

from __future__ import annotations

import math
from dataclasses import dataclass

from decomotion.config import OptimConfig, Schedule

MIN_SECONDS = 1.0
"""A run optimises for this long even where preparation has used up its time."""


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

    def after(self, steps: int) -> Budget:
        """What is left of it when so many of the steps are done; of a time, the run itself knows."""
        return Budget(max(1, self.steps - steps), self.seconds)

    def part(self, share: float, elapsed: float) -> Budget:
        """That share of the steps, or of the time that is left after `elapsed` seconds."""
        seconds = None if self.seconds is None else share * max(self.seconds - elapsed, MIN_SECONDS)
        return Budget(max(1, round(share * self.steps)), seconds)


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

"""How numbers change over a run; `progress` runs from 0 to 1, in steps or in time."""

from __future__ import annotations

import math

from decomotion.config import OptimConfig, Schedule


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

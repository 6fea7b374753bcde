"""The numbers by which an error is told, fitted to answers whose error is known. Each clip weighs the same.

Lengths are in units.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from decomo_runtime.expected_error import LOWEST_SCORE, Calibration
from harness.answers import Answers, Floats

SHARE = 0.8
"""Of answers told e that are to be within e."""
SCORES = (LOWEST_SCORE, 0.003, 0.01, 0.03, 0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 0.95)
GAP_POWERS = tuple(np.arange(0, 1.01, 0.05).round(2).tolist())
QUALITY_POWERS = (0.0, 0.25, 0.5, 0.75, 1.0)
LEAST_TELLING = 3
"""Clips whose models say how good they are; of fewer nothing is learned from it."""
SMALLEST = 0.02
"""Units; errors below it are none."""


@dataclass(frozen=True, eq=False)
class Told:
    """Answers, and what is told of them."""

    answers: Answers
    error: Floats
    """[n], units."""
    refined_error: Floats
    """[n], where they are refined."""


def fit(answers: Sequence[Answers]) -> Calibration:
    """The numbers with the least pinball loss of the errors' logarithms, each clip weighing the same."""
    medians = [each.median for each in answers if each.median is not None]
    typical = float(np.exp(np.mean(np.log(medians)))) if medians else 1.0
    telling = {each.clip for each in answers if each.median is not None}
    powers = QUALITY_POWERS if len(telling) >= LEAST_TELLING else (0.0,)
    weight = np.concatenate(weights(answers))
    edges = np.sqrt(np.multiply(SCORES[1:], SCORES[:-1]))
    knot = np.digitize(np.concatenate([each.score for each in answers]), edges)
    best: tuple[float, Calibration] | None = None
    for gap_power, quality_power in product(GAP_POWERS, powers):
        flat = Calibration(SHARE, SCORES, (1.0,) * len(SCORES), gap_power, quality_power, typical)
        over = np.log(np.concatenate([np.maximum(each.error, SMALLEST) / each.told(flat) for each in answers]))
        here = [knot == number for number in range(len(SCORES))]
        full = [number for number, rows in enumerate(here) if rows.any()]
        levels = [_quantile(over[here[number]], weight[here[number]]) for number in full]
        curve = np.interp(np.log(SCORES), np.log(SCORES)[full], np.maximum.accumulate(levels))
        fitted = replace(flat, errors=tuple(float(f"{value:.4g}") for value in np.exp(curve)))
        loss = pinball(answers, fitted)
        if best is None or loss < best[0]:
            best = loss, fitted
    assert best is not None
    factor = _refined_factor(answers, best[1])
    return replace(best[1], refined_factor=factor, clips=tuple(sorted({each.clip for each in answers})))


def _refined_factor(answers: Sequence[Answers], calibration: Calibration) -> float:
    """What the quantile `SHARE` of refined answers' errors is, by what they were told; 1 at most."""
    over = np.concatenate([each.refined_error / each.told(calibration) for each in answers])
    found = np.isfinite(over)
    if not found.any():
        return 1.0
    return min(1.0, round(_quantile(over[found], np.concatenate(weights(answers))[found]), 3))


def pinball(answers: Sequence[Answers], calibration: Calibration) -> float:
    """Mean over clips of how badly the told errors are the quantile `SHARE`, in logarithms; 0 is best."""
    over = [np.log(np.maximum(each.error, SMALLEST) / each.told(calibration)) for each in answers]
    loss = [np.where(each > 0, SHARE * each, (SHARE - 1) * each) for each in over]
    return float(np.average(np.concatenate(loss), weights=np.concatenate(weights(answers))))


def left_out(answers: Sequence[Answers]) -> list[Told]:
    """Each model's answers, and what they are told by numbers that were fitted to other clips."""
    clips = sorted({each.clip for each in answers})
    others = {clip: fit([each for each in answers if each.clip != clip]) for clip in clips}
    told = [(each, each.told(others[each.clip]), others[each.clip].refined_factor) for each in answers]
    return [Told(each, error, factor * error) for each, error, factor in told]


def weights(answers: Sequence[Answers]) -> list[Floats]:
    """Of each answer: those of a clip weigh 1 together."""
    total: dict[str, int] = {}
    for each in answers:
        total[each.clip] = total.get(each.clip, 0) + len(each.error)
    return [np.full(len(each.error), 1 / total[each.clip]) for each in answers]


def _quantile(values: Floats, weight: Floats) -> float:
    order = np.argsort(values)
    reached = np.cumsum(weight[order])
    return float(values[order][np.searchsorted(reached, SHARE * reached[-1])])

"""The budget of linking: at which gaps flow is computed, and how many points are linked, in the time there is.

What preparation takes at the least is estimated before any long work, and a clip that is too long for its time is
refused. Flow then has its share of the time, or what all points leave; and points are thinned until linking them, and
what is done with them later, fits into the rest.
"""

from __future__ import annotations

import json
import logging
import math
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from decomotion.clip import Clip
from decomotion.data.config import FIT_SHARE, DataConfig
from decomotion.data.flow.interface import kept
from decomotion.data.links import costs
from decomotion.data.links.flow_store import FlowStore, at_once
from decomotion.data.links.intervals import choose_intervals, count_fields
from decomotion.data.stages import write_whole
from decomotion.errors import SupervisionError

log = logging.getLogger(__name__)

TRIALS = 3
"""Of what a search for flow costs, for each that is made at a time."""
FLOW_SHARE = 0.6
"""Share of the time for flow and points that flow may take where there is not enough for all points."""
PATIENCE = 60.0
"""Seconds that preparation may take in any case: only longer work is refused."""


def check_time(
    clip: Clip, config: DataConfig, flows: FlowStore, wanted: int, rounds: float, later: costs.LaterCosts
) -> costs.Costs:
    """What points cost that are linked so many times, in the mean, and what follows the links `later`.

    Raises `SupervisionError` where preparation takes longer than its budget even with flow between neighbours alone
    and `costs.MIN_POINTS` points a frame, of which `wanted` are wanted.
    """
    frames, points = len(clip), min(wanted, costs.MIN_POINTS)
    hop = costs.hop_costs(clip, kept(clip.height, clip.width, config.flow.field_side), wanted).times(rounds)
    parts = {
        "matching": flows.matches.seconds(),
        "flow between neighbours": flows.seconds(count_fields((1,), frames)),
        f"links of {points} points a frame": points
        * hop.of_a_point(frames, (1,), flows.matches.intervals, config.pool.max_gap),
        "features, masks and structure": later.of(points),
    }
    least = math.ceil(sum(parts.values()))
    if least > max(config.prepare_budget, PATIENCE):
        what = ", ".join(f"{part} {seconds:.0f}" for part, seconds in parts.items())
        raise SupervisionError(
            f"{frames} frames are too many for the time that there is: to prepare them takes at least {least} seconds "
            f"({what}), and there are {config.prepare_budget:g}; give --prepare-budget {least}s or longer, to "
            f"decomo-train also --time-budget {math.ceil(least / FIT_SHARE)}s or longer for each window, or a part, "
            "CLIP@A:B"
        )
    return costs.Costs(hop, later)


def scheduled(
    clip: Clip,
    config: DataConfig,
    flows: FlowStore,
    wanted: int,
    price: costs.Costs | None,
    seconds: float,
    file: Path,
) -> dict[str, Any]:
    """The gaps at which flow is computed, what a search for it costs, and how many points of each frame are linked.

    From `file` where an earlier run has chosen already. The cost is that of the first few fields, which are kept.
    Between neighbours a second search may follow. `price` is what points cost and what follows them; without it
    neither gaps nor points are thinned. `seconds` are left for all of that: gaps `geometric` and `all` depend on them,
    and so do the points then, of which there are at most `wanted`.
    """
    if file.is_file():
        return json.loads(file.read_text(encoding="utf-8"))
    shutil.rmtree(flows.folder, ignore_errors=True)  # of trials that were stopped: what is there costs nothing
    flows.compute((1,), progress=False, only=slice(TRIALS * at_once(flows.estimator)))
    cost = flows.seconds_a_search()
    frames, max_gap = len(clip), config.pool.max_gap
    spare = seconds if price is None else seconds - price.later.fixed

    def flow(gaps: tuple[int, ...]) -> float:
        return cost * sum(flows.effort(gap) * count_fields((gap,), frames) for gap in gaps)

    def each(gaps: tuple[int, ...]) -> float:
        return 0.0 if price is None else price.of_a_point(frames, gaps, flows.matches.intervals, max_gap)

    def affordable(gaps: tuple[int, ...]) -> bool:
        return flow(gaps) <= max(FLOW_SHARE * spare, spare - wanted * each(gaps))

    intervals = choose_intervals(config.flow, frames, max_gap, affordable)
    points = wanted
    if price is not None:
        points = costs.affordable_points(wanted, each(intervals), spare - flow(intervals))
    thinned = what_is_thinned(config, frames, intervals, points, wanted)
    if thinned is not None:
        log.warning("%s; for all, give a longer --prepare-budget or --time-budget", thinned)
    chosen = {
        "intervals": list(intervals),
        "seconds_per_search": cost,
        "points": points,
        "thinned": thinned is not None,
    }
    write_whole(file, lambda path: path.write_text(json.dumps(chosen), encoding="utf-8"))
    return chosen


def what_is_thinned(config: DataConfig, frames: int, intervals: Sequence[int], points: int, wanted: int) -> str | None:
    """What the budget has left out, in a line, with flow at these gaps and so many of the `wanted` points linked.

    None where that is all of both.
    """
    every = choose_intervals(config.flow, frames, config.pool.max_gap, lambda _: True)
    gaps = [f"flow at gaps {_listed(intervals)} of {_listed(every)}"] if tuple(intervals) != every else []
    fewer = [f"{points} of {wanted} points a frame"] if points < wanted else []
    return " and ".join(gaps + fewer) + ": budget" if gaps or fewer else None


def _listed(gaps: Sequence[int]) -> str:
    return ", ".join(map(str, gaps))

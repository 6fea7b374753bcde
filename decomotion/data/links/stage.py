"""The stage `links`: flow at the scheduled gaps, linked to every gap, for points of every frame.

What moves has a flow of its own as well, where it is known: what given masks hold, in one round with all else; or what
is found by the links, whose points are then linked once more.

The flows lie in `flow/` and `own/` of the partial stage, and are removed when the links are made.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from decomotion.arrays import allocated_memmap
from decomotion.clip import Clip
from decomotion.data.config import DataConfig
from decomotion.data.flow import FlowEstimator
from decomotion.data.flow.interface import kept
from decomotion.data.links.budget import check_time, scheduled
from decomotion.data.links.costs import later_costs
from decomotion.data.links.flow_store import FlowStore
from decomotion.data.links.intervals import pairs_of
from decomotion.data.links.layer import Layer, Mask
from decomotion.data.links.linker import FOUND, LINKED, Linker, parts_done
from decomotion.data.links.matcher import Matcher
from decomotion.data.links.matching import MatchStore
from decomotion.data.links.tracks import UserTracks
from decomotion.data.pool import grid_shape, jittered_grid
from decomotion.data.positions import PackedPositions, pack
from decomotion.data.sampling import bilinear, rescaled
from decomotion.memory import give_back

SCHEDULE = "schedule.json"
"""The gaps and points that were chosen: an interrupted run goes on with them, however fast the machine is then."""
USUAL = 0.3
"""Share of a frame that is searched once more for what is found to move, and of points that are linked once more."""

Linked = tuple[npt.NDArray[np.float32], PackedPositions, npt.NDArray[np.uint8], tuple[int, int]]
"""Points, targets, confidence, and rows and columns of the grid, as in the pool."""


@dataclass(frozen=True)
class Found:
    """What moves, where that is not given."""

    masks: Callable[[Linked], Iterable[Mask]]
    """It in each frame, [h, w], by links."""
    outlined: bool
    """Whether a network has drawn its outlines."""


def build_links(
    clip: Clip,
    working: Clip,
    config: DataConfig,
    wanted: int,
    seconds_after: Callable[[int], float],
    random: np.random.Generator,
    tracks: UserTracks | None,
    estimator: FlowEstimator,
    matcher: Matcher,
    masks: Iterable[Mask] | None,
    found: Found | None,
    progress: bool,
    folder: Path,
    spent: float,
) -> dict[str, Any]:
    """Fills the stage's folder with points, rgb, targets and confidence; returns its facts.

    Positions are in pixels of `clip`; frames are read from `working`, the same clip at the size that preparation works
    at, for which `spent` of the seconds that there are have gone.

    About `wanted` points of each frame are linked by flow, or as many as there is time for, on a grid that `random`
    jitters; those of `tracks` come after them. What `masks` [H, W] hold, one a frame, is followed by itself as well, or
    what is `found` to move by the links. `seconds_after(points)` is what preparation will take afterwards.

    Raises `SupervisionError` where there is too little time, before any long work; gaps that are a list have any.
    """
    begin = time.monotonic()
    matches = MatchStore(working, config.matching.intervals, matcher, folder / "matches", neighbours=estimator.guided)
    raster = kept(working.height, working.width, estimator.field_side)
    given = None if masks is None else Layer(masks, raster)
    beside = given.effort() if given is not None else 0.0 if found is None else USUAL
    flows = FlowStore(working, estimator, matches, folder / "flow", beside)
    price = None
    if isinstance(config.flow.intervals, str) and not (folder / SCHEDULE).is_file():
        rounds = 1.0 if found is None else 1.0 + USUAL
        price = check_time(working, config, flows, wanted, rounds, later_costs(seconds_after, wanted))
    estimated = time.monotonic()
    matches.compute(progress)
    give_back()
    matched = time.monotonic()
    left = config.prepare_budget - spent - (matched - begin)
    schedule = scheduled(working, config, flows, wanted, price, left, folder / SCHEDULE)
    intervals = tuple(schedule["intervals"])
    estimator.require(pairs_of(intervals, len(clip)))
    count_of_flows = flows.compute(intervals, progress)
    linker = Linker(clip, working, config, flows, intervals, matches)
    moving = None if given is None else linker.given(given, progress, folder)
    give_back()
    computed = time.monotonic()

    points = jittered_grid(len(clip), clip.height, clip.width, schedule["points"], random)
    frames, on_grid = points.shape[:2]
    shown = points if tracks is None else np.concatenate([points, tracks.points(clip)], axis=1)
    np.save(folder / "points.npy", shown)
    on_working = rescaled(shown, (clip.height, clip.width), (working.height, working.width))
    colours = [bilinear(frame, xy) for frame, xy in zip(working.frames, on_working, strict=True)]
    np.save(folder / "rgb.npy", np.stack(colours))
    count = shown.shape[1]
    begun = parts_done(folder) > 0
    targets = allocated_memmap(folder / "targets.npy", np.uint16, (frames, frames, count, 2), keep=begun)
    confidence = allocated_memmap(folder / "confidence.npy", np.uint8, (frames, frames, count), keep=begun)
    side = max(clip.height, clip.width)
    for frame in range(frames):
        targets[frame, frame] = pack(shown[frame], side)
        confidence[frame, frame, :on_grid] = 255
        if tracks is not None:
            targets[frame, :, on_grid:] = pack(tracks.xy.swapaxes(0, 1), side)
            confidence[frame, :, on_grid:] = np.round(255 * tracks.confidence_from(frame)).T
    grid = grid_shape(clip.height, clip.width, schedule["points"])
    linked = targets[:, :, :on_grid], confidence[:, :, :on_grid]
    linker.run(points, *linked, moving, progress, folder)
    if found is not None:
        rough = points, PackedPositions(linked[0], side), linked[1], grid
        linker.run_again(points, *linked, partial(found.masks, rough), found.outlined, progress, folder)
    targets.flush()
    confidence.flush()
    for name in ("flow", "own", "matches"):
        shutil.rmtree(folder / name, ignore_errors=True)
    for name in (LINKED, SCHEDULE, FOUND):
        (folder / name).unlink(missing_ok=True)
    give_back()
    return {
        **schedule,
        "fields": count_of_flows,
        "points": count,
        "grid": grid,
        "kept": float(np.mean([(confidence[frame] > 0).mean() for frame in range(frames)])),
        "seconds": {
            "frames": spent,
            "estimate": estimated - begin,
            "matches": matched - estimated,
            "flow": computed - matched,
            "links": time.monotonic() - computed,
        },
    }

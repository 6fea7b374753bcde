"""The stage `links`: flow at the scheduled gaps, linked to every gap, for points of every frame.

The flows lie in `flow/` of the partial stage, and are removed when the links are made.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from decomotion.arrays import allocated_memmap
from decomotion.clip import Clip
from decomotion.data.config import DataConfig
from decomotion.data.flow import FlowEstimator
from decomotion.data.flow.interface import kept
from decomotion.data.links import linking
from decomotion.data.links.budget import check_time, scheduled
from decomotion.data.links.flow_store import FlowStore
from decomotion.data.links.intervals import pairs_of
from decomotion.data.links.layer import Layer, Mask
from decomotion.data.links.matcher import Matcher
from decomotion.data.links.matching import MatchStore
from decomotion.data.links.refinement import Refiner
from decomotion.data.links.tracks import UserTracks
from decomotion.data.pool import grid_shape, jittered_grid, pack
from decomotion.data.sampling import bilinear, rescaled
from decomotion.data.stages import write_whole
from decomotion.memory import forget, give_back

CONFIDENT_VARIANCE = 1.0
"""Accumulated squared error, units^2, at which the confidence is one half."""
SCHEDULE = "schedule.json"
"""The gaps and points that were chosen: an interrupted run goes on with them, however fast the machine is then."""
LINKED = "linked"
"""How many of the parts of linking are done: an interrupted run goes on after them."""
LINKED_AT_ONCE = 256 << 20
"""Bytes of the states of the points that are linked at a time; every further part reads the flows again."""


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
    progress: bool,
    folder: Path,
    spent: float,
) -> dict[str, Any]:
    """Fills the stage's folder with points, rgb, targets and confidence; returns its facts.

    Positions are in pixels of `clip`; frames are read from `working`, the same clip at the size that preparation works
    at, for which `spent` of the seconds that there are have gone.

    About `wanted` points of each frame are linked by flow, or as many as there is time for, on a grid that `random`
    jitters; those of `tracks` come after them. What `masks` [H, W] hold, one a frame, is followed by itself as well.
    `seconds_after(points)` is what preparation will take afterwards.

    Raises `SupervisionError` where there is too little time, before any long work; gaps that are a list have any.
    """
    begin = time.monotonic()
    matches = MatchStore(working, config.matching.intervals, matcher, folder / "matches", neighbours=estimator.guided)
    raster = kept(working.height, working.width, estimator.field_side)
    flows = FlowStore(working, estimator, matches, folder / "flow", None if masks is None else Layer(masks, raster))
    after, hop = 0.0, None
    if isinstance(config.flow.intervals, str) and not (folder / SCHEDULE).is_file():
        hop = check_time(working, config, flows, wanted, seconds_after)
        after = seconds_after(wanted)
    estimated = time.monotonic()
    matches.compute(progress)
    give_back()
    matched = time.monotonic()
    left = config.prepare_budget - spent - (matched - begin) - after
    schedule = scheduled(working, config, flows, wanted, hop, left, folder / SCHEDULE)
    intervals = tuple(schedule["intervals"])
    estimator.require(pairs_of(intervals, len(clip)))
    count_of_flows = flows.compute(intervals, progress)
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
    linker = _Linker(clip, working, config, flows, intervals, matches)
    linker.run(points, targets[:, :, :on_grid], confidence[:, :, :on_grid], progress, folder)
    side = max(clip.height, clip.width)
    for frame in range(frames):
        targets[frame, frame] = pack(shown[frame], side)
        confidence[frame, frame, :on_grid] = 255
        if tracks is not None:
            targets[frame, :, on_grid:] = pack(tracks.xy.swapaxes(0, 1), side)
            confidence[frame, :, on_grid:] = np.round(255 * tracks.confidence_from(frame)).T
    targets.flush()
    confidence.flush()
    shutil.rmtree(folder / "flow")
    shutil.rmtree(folder / "matches")
    for file in (LINKED, SCHEDULE):
        (folder / file).unlink()
    give_back()
    return {
        **schedule,
        "fields": count_of_flows,
        "points": count,
        "grid": grid_shape(clip.height, clip.width, schedule["points"]),
        "kept": float(np.mean([(confidence[frame] > 0).mean() for frame in range(frames)])),
        "seconds": {
            "frames": spent,
            "estimate": estimated - begin,
            "matches": matched - estimated,
            "flow": computed - matched,
            "links": time.monotonic() - computed,
        },
    }


def parts_done(folder: Path) -> int:
    """Parts of linking that an interrupted run has left in the stage's folder."""
    file = folder / LINKED
    return int(file.read_text(encoding="ascii")) if file.is_file() else 0


class _Linker:
    """Links the points of every frame to every other, part by part."""

    def __init__(
        self,
        clip: Clip,
        working: Clip,
        config: DataConfig,
        flow: FlowStore,
        intervals: tuple[int, ...],
        matches: MatchStore,
    ) -> None:
        self._clip, self._pool, self._flow, self._intervals = clip, config.pool, flow, intervals
        refine = Refiner(working)
        self._rematching = linking.Rematching(matches, matches.intervals, refine) if matches.intervals else None
        layer = flow.layer
        self._moving = None if layer is None else linking.Moving(flow.alone, layer.mask, layer.reach)
        self._longest = min(len(clip), max(intervals + matches.intervals))

    def run(
        self,
        points: npt.NDArray[np.float32],
        targets: npt.NDArray[np.uint16],
        confidence: npt.NDArray[np.uint8],
        progress: bool,
        folder: Path,
    ) -> None:
        """Fills `targets` and `confidence`, but for the frames themselves; `folder` remembers which parts are done."""
        frames, done, parts = len(self._clip), parts_done(folder), self._parts(points.shape[1])
        with tqdm(
            total=frames * len(parts), initial=frames * done, desc="link", disable=not progress, leave=False
        ) as bar:
            for number, (which, step) in enumerate(parts[done:], done + 1):
                self._link(points[:, which], targets[:, :, which], confidence[:, :, which], step, bar)
                write_whole(folder / LINKED, partial(Path.write_text, data=str(number), encoding="ascii"))

    def _parts(self, points: int) -> list[tuple[slice, int]]:
        """Which points are linked at a time, and which way in time: as many as fit into `LINKED_AT_ONCE`."""
        at_once = max(1, LINKED_AT_ONCE // (linking.BYTES_A_POINT * len(self._clip) * self._longest))
        return [(slice(first, first + at_once), step) for first in range(0, points, at_once) for step in (1, -1)]

    def _link(
        self,
        points: npt.NDArray[np.float32],
        targets: npt.NDArray[np.uint16],
        confidence: npt.NDArray[np.uint8],
        step: int,
        bar: tqdm,
    ) -> None:
        pool, sides, raster = self._pool, (self._clip.height, self._clip.width), self._flow(0, 1).shape[:2]
        on_raster = rescaled(points, sides, raster)
        for links in linking.link(
            on_raster,
            self._flow,
            self._intervals,
            pool.cycle_threshold,
            pool.max_gap,
            step,
            self._rematching,
            self._moving,
        ):
            for source, xy, variance, occluded in zip(
                links.sources, links.xy, links.variance, links.occluded, strict=True
            ):
                targets[source, links.target] = pack(rescaled(xy, raster, sides), max(sides))
                certain = np.float32(255 * CONFIDENT_VARIANCE) / (np.float32(CONFIDENT_VARIANCE) + variance)
                certain[occluded] = 0
                confidence[source, links.target] = np.round(certain)
            forget(targets)
            forget(confidence)
            bar.update()

"""The stage `links`: flow at the scheduled gaps, linked to every gap, for points of every frame.

What moves has a flow of its own as well, where it is known: what given masks hold, in one round with all else; or what
is found by the links, whose points are then linked once more.

The flows lie in `flow/` and `own/` of the partial stage, and are removed when the links are made.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterable, Sequence
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
from decomotion.data.links.own_flow import OwnFlow
from decomotion.data.links.refinement import Refiner
from decomotion.data.links.tracks import UserTracks
from decomotion.data.pool import PackedPositions, grid_shape, jittered_grid, pack
from decomotion.data.sampling import bilinear, nearest, rescaled
from decomotion.data.stages import write_array, write_whole
from decomotion.memory import forget, give_back

CONFIDENT_VARIANCE = 1.0
"""Accumulated squared error, units^2, at which the confidence is one half."""
SCHEDULE = "schedule.json"
"""The gaps and points that were chosen: an interrupted run goes on with them, however fast the machine is then."""
LINKED = "linked"
"""How many of the parts of linking are done: an interrupted run goes on after them."""
LINKED_AT_ONCE = 256 << 20
"""Bytes of the states of the points that are linked at a time; every further part reads the flows again."""
FOUND = "found.npy"
"""What was found to move, for an interrupted run: it has linked some of that anew."""
USUAL = 0.3
"""Share of a frame that is searched once more for what is found to move, and of its points, in estimates."""

Found = Callable[[npt.NDArray[np.float32], PackedPositions, npt.NDArray[np.uint8], tuple[int, int]], Iterable[Mask]]
"""What moves in each frame, [h, w], by points, targets, confidence, and rows and columns, as in the pool."""


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
    linker = _Linker(clip, working, config, flows, intervals, matches)
    moving = None if given is None else linker.followed(given, True, progress, folder)
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
        linker.run_again(points, *linked, partial(found, *rough), progress, folder)
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


def parts_done(folder: Path) -> int:
    """Parts of linking that an interrupted run has left in the stage's folder."""
    file = folder / LINKED
    return int(file.read_text(encoding="ascii")) if file.is_file() else 0


Which = slice | npt.NDArray[np.int64]
"""Of the points of a frame."""


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
        self._clip, self._working, self._pool, self._flow = clip, working, config.pool, flow
        self._intervals = intervals
        refine = Refiner(working)
        self._rematching = linking.Rematching(matches, matches.intervals, refine) if matches.intervals else None
        self._longest = min(len(clip), max(intervals + matches.intervals))

    def followed(self, layer: Layer, bounded: bool, progress: bool, folder: Path) -> linking.Moving:
        """What is in a layer, with its own flow; `bounded`: hidden elsewhere."""
        own = OwnFlow(self._working, self._flow.estimator, layer, folder / "own")
        own.compute(self._intervals, progress)
        return linking.Moving(own, layer.mask, layer.reach if bounded else None)

    def run(
        self,
        points: npt.NDArray[np.float32],
        targets: npt.NDArray[np.uint16],
        confidence: npt.NDArray[np.uint8],
        moving: linking.Moving | None,
        progress: bool,
        folder: Path,
    ) -> None:
        """Fills `targets` and `confidence`, but for the frames themselves; `folder` remembers which parts are done."""
        frames, done, parts = len(self._clip), parts_done(folder), self._parts(points.shape[1])
        with tqdm(
            total=frames * len(parts), initial=frames * done, desc="link", disable=not progress, leave=False
        ) as bar:
            for number, (which, step) in enumerate(parts[done:], done + 1):
                every = [which] * frames
                self._link(points[:, which], every, targets, confidence, moving, step, bar)
                _note(folder, number)

    def run_again(
        self,
        points: npt.NDArray[np.float32],
        targets: npt.NDArray[np.uint16],
        confidence: npt.NDArray[np.uint8],
        found: Callable[[], Iterable[Mask]],
        progress: bool,
        folder: Path,
    ) -> None:
        """Links those points anew that are `found` to move, by their own flow too, after `run`."""
        if not (folder / FOUND).is_file():
            write_array(folder / FOUND, np.stack(list(found())))
        masks = np.load(folder / FOUND)
        if not masks.any():
            return
        sides, raster = (self._clip.height, self._clip.width), self._flow(0, 1).shape[:2]
        moving = self.followed(Layer(masks, raster[::-1]), False, progress, folder)
        first = len(self._parts(points.shape[1]))
        moves = [nearest(mask, rescaled(xy, sides, mask.shape)) for mask, xy in zip(masks, points, strict=True)]
        some, frames = _padded(moves), np.arange(len(points))[:, None]
        done, parts = parts_done(folder) - first, self._parts(some.shape[1])
        with tqdm(
            total=len(frames) * len(parts), initial=len(frames) * done, desc="link", disable=not progress, leave=False
        ) as bar:
            for number, (which, step) in enumerate(parts[done:], first + done + 1):
                part = some[:, which]
                self._link(points[frames, part], list(part), targets, confidence, moving, step, bar)
                _note(folder, number)

    def _parts(self, points: int) -> list[tuple[slice, int]]:
        """Which points are linked at a time, and which way in time: as many as fit into `LINKED_AT_ONCE`."""
        at_once = max(1, LINKED_AT_ONCE // (linking.BYTES_A_POINT * len(self._clip) * self._longest))
        return [(slice(first, first + at_once), step) for first in range(0, points, at_once) for step in (1, -1)]

    def _link(
        self,
        points: npt.NDArray[np.float32],
        which: Sequence[Which],
        targets: npt.NDArray[np.uint16],
        confidence: npt.NDArray[np.uint8],
        moving: linking.Moving | None,
        step: int,
        bar: tqdm,
    ) -> None:
        """Of `points` [frame, n, 2], which are those points of each frame."""
        pool, sides, raster = self._pool, (self._clip.height, self._clip.width), self._flow(0, 1).shape[:2]
        on_raster = rescaled(points, sides, raster)
        how = (pool.cycle_threshold, pool.max_gap, step, self._rematching, moving)
        for links in linking.link(on_raster, self._flow, self._intervals, *how):
            for source, xy, variance, occluded in zip(
                links.sources, links.xy, links.variance, links.occluded, strict=True
            ):
                targets[source, links.target, which[source]] = pack(rescaled(xy, raster, sides), max(sides))
                certain = np.float32(255 * CONFIDENT_VARIANCE) / (np.float32(CONFIDENT_VARIANCE) + variance)
                certain[occluded] = 0
                confidence[source, links.target, which[source]] = np.round(certain)
            forget(targets)
            forget(confidence)
            bar.update()


def _padded(chosen: Sequence[npt.NDArray[np.bool_]]) -> npt.NDArray[np.int64]:
    """[frame, n]: the places of those `chosen`, the first as often as it takes; that of none is 0."""
    places = [np.flatnonzero(each) if each.any() else np.zeros(1, np.int64) for each in chosen]
    most = max(len(each) for each in places)
    return np.stack([np.append(each, np.full(most - len(each), each[0])) for each in places])


def _note(folder: Path, parts: int) -> None:
    write_whole(folder / LINKED, partial(Path.write_text, data=str(parts), encoding="ascii"))

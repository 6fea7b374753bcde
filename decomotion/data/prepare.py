"""From a clip to its supervision: a list of stages, each kept in the cache, read together as one pool."""

from __future__ import annotations

import hashlib
import logging
import math
import os
import time
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from decomotion.chance import generator
from decomotion.clip import Clip
from decomotion.data.config import FIT_SHARE, DataConfig
from decomotion.data.features import FeatureExtractor, build_features
from decomotion.data.features.interface import MOST_CHANNELS
from decomotion.data.features.stage import build_feature_arrays
from decomotion.data.flow import FlowEstimator, build_flow
from decomotion.data.flow.config import FolderFlowConfig, RaftFlowConfig
from decomotion.data.links.budget import what_is_thinned
from decomotion.data.links.config import MatchingConfig
from decomotion.data.links.costs import MIN_POINTS
from decomotion.data.links.filtering import Grid, build_filtered
from decomotion.data.links.intervals import pairs_of
from decomotion.data.links.matcher import Matcher
from decomotion.data.links.matching import build_matcher
from decomotion.data.links.stage import build_links
from decomotion.data.links.tracks import UserTracks, read_tracks
from decomotion.data.masks.cost import seconds_a_frame
from decomotion.data.masks.folder import MaskFiles, read_masks
from decomotion.data.motion import build_motion
from decomotion.data.pool import PackedPositions, Pool, affordable_points, grid_shape, jittered_grid, open_pool
from decomotion.data.sampling import rescaled, sample_map
from decomotion.data.stages import Record, Stage, remove_abandoned, settings_of_finished
from decomotion.data.timing import least_seconds
from decomotion.data.working import build_frames, working_clip, working_side
from decomotion.errors import DownloadError, SupervisionError
from decomotion.files import digest_of
from decomotion.memory import give_back

log = logging.getLogger(__name__)

PLACES = {"path", "weights"}
"""Settings of flow that say where files lie: their content counts, not their names."""
VERSIONS = {"frames": 1, "links": 11, "features": 2, "filter": 1, "motion": 5}
"""Raised for a stage whenever the same clip and settings would give another result."""


@dataclass(frozen=True)
class Preparation:
    """A prepared clip."""

    pool: Pool
    stages: tuple[Record, ...]
    """In the order in which they are made."""
    folder: Path
    """Where the clip's stages lie."""
    grid: tuple[int, int]
    """Rows and columns of the pool's jittered points, which come first in every frame."""


def cache_root() -> Path:
    """Where prepared supervision is kept: `$DECOMO_CACHE`, or `~/.cache/decomotion`."""
    return Path(os.environ.get("DECOMO_CACHE") or Path.home() / ".cache" / "decomotion")


def prepare(
    clip: Clip,
    config: DataConfig,
    *,
    seed: int = 0,
    rebuild: bool = False,
    progress: bool = True,
    device: str = "cpu",
) -> Pool:
    """The pool of `clip`, from the cache where it was prepared before with the same settings.

    `seed` decides which points are prepared; networks run on `device`. Raises `SupervisionError` where flow, weights,
    masks or tracks are missing or do not fit.
    """
    return prepare_in_stages(clip, config, seed=seed, rebuild=rebuild, progress=progress, device=device).pool


def prepare_in_stages(
    clip: Clip,
    config: DataConfig,
    *,
    seed: int = 0,
    rebuild: bool = False,
    progress: bool = True,
    device: str = "cpu",
) -> Preparation:
    """As `prepare`, with the record of each stage."""
    work = _Work(clip, config, seed, rebuild, progress, device)
    remove_abandoned(work.root)
    work.check()
    records = [work.links.run(work.build_links, rebuild), work.features.run(work.build_features, rebuild)]
    if work.filters_on:
        records.append(work.filter.run(work.build_filter, rebuild))
    records.append(work.motion.run(work.build_motion, rebuild))
    give_back()
    pool = open_pool([record.folder for record in records], work.longer_side, work.thinned)
    return Preparation(pool, tuple(records), work.root, (work.grid.rows, work.grid.columns))


def affordable(clip: Clip, config: DataConfig, seconds: float, *, seed: int = 0, rebuild: bool = False) -> DataConfig:
    """`config` for a fit of so many seconds: with less of a budget where preparation would leave the fit too little.

    Links that are in the cache cost nothing: a `config` that has some stays, unless they are to be rebuilt, and where
    some are there that were made with a longer budget than there would be, theirs is taken.
    """
    share = FIT_SHARE * seconds
    if share >= config.prepare_budget or (not rebuild and _Work(clip, config, seed).links.finished):
        return config
    shorter = config.model_copy(update={"prepare_budget": share})
    links = _Work(clip, shorter, seed, rebuild).links
    return shorter.model_copy(update={"prepare_budget": max(share, links.settings["budget"] or share)})


class _Work:
    """One clip and its settings: the stages, and what each is built from."""

    def __init__(
        self,
        clip: Clip,
        config: DataConfig,
        seed: int,
        rebuild: bool = False,
        progress: bool = False,
        device: str = "cpu",
    ) -> None:
        self.clip, self.config, self.seed, self.rebuild = clip, config, seed, rebuild
        self.progress, self.device = progress, device
        self.networks: Matcher | None = None
        """Of the matches, where `matching` had to see whether they can be had."""
        self.root = cache_root() / clip.digest()
        self.longer_side = max(clip.height, clip.width)
        rules = config.rules
        self.filters_on = any(rule is not None for rule in (rules.cycle, rules.appearance, rules.second_look))

    def check(self) -> None:
        """Reads all that the user gives and loads the networks that will be needed, before any long work."""
        _ = self.given_masks, self.tracks
        pool = self.config.pool
        if self.count < pool.points_per_frame:
            what = "%d MiB have room for %d of %d points a frame; for all of them raise data.pool.disk_limit"
            log.warning(what, pool.disk_limit, self.count, pool.points_per_frame)
        if self.config.feature_weights is not None and not Path(self.config.feature_weights).is_file():
            raise SupervisionError(f"--feature-weights {self.config.feature_weights} does not exist")
        if self.rebuild or not self.links.finished:
            _ = self.matcher
            self.estimator.require(pairs_of((1,), len(self.clip)))
        if self.rebuild or not self.links.finished or not self.features.finished:
            _ = self.extractor

    # what the stages are made from

    @cached_property
    def working(self) -> Clip:
        """The clip at the size that preparation works at, on disk; made when the first stage asks for it."""
        side = working_side(self.config.flow)
        made = self.stage("frames", side=side).run(partial(self.build_frames, side), self.rebuild)
        return working_clip(self.clip, made.folder)

    @cached_property
    def estimator(self) -> FlowEstimator:
        return build_flow(self.config.flow, self.device)

    @cached_property
    def matching(self) -> MatchingConfig:
        """Settings of the matches: dense SIFT's where the weights for others can be had nowhere."""
        wanted = self.config.matching
        if not wanted.intervals:
            return wanted.model_copy(update={"kind": "sift", "weights": ()})
        if wanted.kind == "sift" or (not self.rebuild and self.links_with(wanted).finished):
            return wanted
        try:
            self.networks = build_matcher(wanted, self.device)
        except DownloadError as error:
            log.warning("%s; until then dense SIFT's are taken, which find less of what moves fast", error)
            return wanted.model_copy(update={"kind": "sift"})
        return wanted

    @cached_property
    def matcher(self) -> Matcher:
        matching = self.matching
        return self.networks or build_matcher(matching, self.device)

    @cached_property
    def extractor(self) -> FeatureExtractor | None:
        return build_features(self.config, self.device)

    @cached_property
    def given_masks(self) -> MaskFiles | None:
        if self.config.masks in ("auto", "none"):
            return None
        return read_masks(Path(self.config.masks), len(self.clip), self.clip.height, self.clip.width)

    @property
    def masks_of_links(self) -> MaskFiles | None:
        """Given masks, where flow is to follow by itself what they hold."""
        return self.given_masks if getattr(self.config.flow, "alone", False) else None

    @cached_property
    def tracks(self) -> UserTracks | None:
        return None if self.config.tracks is None else read_tracks(self.config.tracks, self.clip)

    @cached_property
    def count(self) -> int:
        """Points of a frame that are linked, about: as many as wanted, or as the pool's limit on disk admits."""
        given = 0 if self.tracks is None else len(self.tracks)
        limit = affordable_points(len(self.clip), self.channels, self.config.pool.disk_limit, self.filters_on) - given
        wanted = self.config.pool.points_per_frame
        if limit < min(wanted, MIN_POINTS):
            what = f"{given} tracks leave" if given else "it leaves"
            raise SupervisionError(
                f"a pool of {self.config.pool.disk_limit} MiB is too small for {len(self.clip)} frames: {what} "
                f"room for {max(0, limit)} points a frame; raise data.pool.disk_limit, or give fewer frames"
            )
        return min(wanted, limit)

    @cached_property
    def channels(self) -> int:
        """Of the features in the pool, at most."""
        most = MOST_CHANNELS[self.config.features]
        return min(self.config.feature_size or most, most)

    @cached_property
    def grid(self) -> Grid:
        """The jittered grid of the points that were linked."""
        rows, columns = self.links.record(cached=True).facts["grid"]
        return Grid(rows, columns, self.clip.height, self.clip.width)

    @cached_property
    def thinned(self) -> str | None:
        """What of the finished links there was no time for, in a line; None: nothing."""
        linked, whole = (self.grid.rows, self.grid.columns), grid_shape(self.clip.height, self.clip.width, self.count)
        points = self.count if linked == whole else math.prod(linked)
        intervals = self.links.record(cached=True).facts["intervals"]
        return what_is_thinned(self.config, len(self.clip), intervals, points, self.count)

    # the stages: of what each is the result; gaps follow the time there was, so that links are known by their record

    def stage(self, name: str, **settings: Any) -> Stage:
        versioned = {"version": VERSIONS[name], "clip": self.clip.digest(), **settings}
        return Stage(name, versioned, self.root)

    @cached_property
    def links(self) -> Stage:
        """Those that are finished already where they are no worse than what is asked for."""
        return self.links_with(self.matching)

    def links_with(self, matching: MatchingConfig) -> Stage:
        """As `links`, with matches of these settings."""
        config = self.config
        asked = self.stage(
            "links",
            flow=config.flow.model_dump(mode="json", exclude=PLACES),
            given=self.digest_of_flow(),
            budget=config.prepare_budget if isinstance(config.flow.intervals, str) else None,
            points=self.count,
            seed=self.seed,
            cycle_threshold=config.pool.cycle_threshold,
            max_gap=config.pool.max_gap,
            matching=matching.model_dump(mode="json", exclude={"weights"}),
            match_weights=[file_digest(Path(file)) for file in matching.weights],
            tracks=None if self.tracks is None else self.tracks.digest(),
            masks=None if self.masks_of_links is None else self.masks_of_links.digest,
        )
        return asked if self.rebuild or asked.finished else self.no_worse(asked) or asked

    def no_worse(self, links: Stage) -> Stage | None:
        """Of finished links that differ from `links` in nothing but the budget, the least that are no worse.

        They were made with a longer budget, or are all that is wanted.
        """
        budget = links.settings["budget"]
        others = (Stage("links", settings, self.root) for settings in settings_of_finished("links", self.root))
        alike = [each for each in others if {**each.settings, "budget": None} == {**links.settings, "budget": None}]
        alike = [each for each in alike if budget is not None and each.finished]
        serving = [each for each in alike if each.settings["budget"] >= budget or not _thinned(each)]
        return min(serving, key=lambda each: each.settings["budget"], default=None)

    @cached_property
    def features(self) -> Stage:
        config = self.config
        return self.stage(
            "features",
            kind=config.features,
            weights=None if config.feature_weights is None else file_digest(Path(config.feature_weights)),
            size=config.feature_size,
            grid=[self.grid.rows, self.grid.columns],
            seed=self.seed,
            tracks=None if self.tracks is None else self.tracks.digest(),
        )

    @cached_property
    def filter(self) -> Stage:
        rules = self.config.rules.model_dump(mode="json")
        return self.stage("filter", links=self.links.made, features=self.features.key, rules=rules)

    @cached_property
    def motion(self) -> Stage:
        kind = self.config.masks if self.given_masks is None else "given"
        given = self.given_masks
        return self.stage(
            "motion",
            links=self.filter.key if self.filters_on else self.links.made,
            kind=kind,
            given=None if given is None else given.digest,
        )

    def digest_of_flow(self) -> str | None:
        """Hash of the files that decide the flow beside the settings."""
        flow = self.config.flow
        if isinstance(flow, RaftFlowConfig) and flow.weights is not None:
            return file_digest(Path(flow.weights))
        if isinstance(flow, FolderFlowConfig):
            return folder_digest(Path(flow.path))
        return None

    # how each is made

    def build_frames(self, side: int, folder: Path) -> dict[str, Any]:
        return build_frames(self.clip, side, self.progress, folder)

    def build_links(self, folder: Path) -> dict[str, Any]:
        begin, random = time.monotonic(), generator(self.seed, "points")
        clips = self.clip, self.working
        given = (self.tracks, self.estimator, self.matcher, self.masks_of_links)
        how = (self.progress, folder, time.monotonic() - begin)
        return build_links(*clips, self.config, self.count, self.seconds_after_links, random, *given, *how)

    def seconds_after_links(self, points: int) -> float:
        """What features and masks will take on this machine, about, by those of a frame with so many points."""
        frames, extractor, seconds = self.working.frames, self.extractor, 0.0
        if extractor is not None:
            sides = (self.working.height, self.working.width)
            where = jittered_grid(1, *sides, points, generator(self.seed, "cost"))[0]
            seconds += least_seconds(lambda: sample_map(extractor(frames[0]), where, *sides))
        if self.config.masks == "auto":
            seconds += seconds_a_frame(frames, points, generator(self.seed, "cost"))
        return len(frames) * seconds

    def build_features(self, folder: Path) -> dict[str, Any]:
        points, clip = np.load(self.links.folder / "points.npy"), self.working
        points = rescaled(points, (self.clip.height, self.clip.width), (clip.height, clip.width))
        return build_feature_arrays(clip, points, self.extractor, self.config.feature_size, self.progress, folder)

    def build_filter(self, folder: Path) -> dict[str, Any]:
        feature = np.load(self.features.folder / "feature.npy", mmap_mode="r")
        return build_filtered(*self.linked(), feature, self.grid, self.config.rules, self.progress, folder)

    def build_motion(self, folder: Path) -> dict[str, Any]:
        points, targets, confidence = self.linked()
        if self.filters_on:
            confidence = np.load(self.filter.folder / "confidence.npy", mmap_mode="r")
        grid, given = (self.grid.rows, self.grid.columns), self.given_masks
        kind = self.config.masks
        random = generator(self.seed, "masks")
        linked = (points, targets, confidence, grid)
        sides = (self.clip.height, self.clip.width)
        frames = self.working.frames if kind == "auto" else None
        return build_motion(frames, sides, *linked, kind, given, random, self.progress, folder)

    def linked(self) -> tuple[npt.NDArray[np.float32], PackedPositions, npt.NDArray[np.uint8]]:
        """Points, targets and confidence of the stage `links`."""
        points, targets, confidence = (
            np.load(self.links.folder / f"{name}.npy", mmap_mode="r") for name in ("points", "targets", "confidence")
        )
        return np.asarray(points), PackedPositions(targets, self.longer_side), confidence


def _thinned(links: Stage) -> bool:
    """Whether finished links have fewer points or gaps than were wanted."""
    return links.record(cached=True).facts.get("thinned", True)


def file_digest(file: Path) -> str | None:
    """Hash of a file's content; None where there is none, which whoever reads it reports."""
    return digest_of(file) if file.is_file() else None


def folder_digest(folder: Path) -> str | None:
    """Hash of the names and contents of the files in a folder; None where there is none."""
    if not folder.is_dir():
        return None
    content = hashlib.sha256()
    for file in sorted(file for file in folder.iterdir() if file.is_file()):
        content.update(f"{file.name}|{file_digest(file)}|".encode())
    return content.hexdigest()

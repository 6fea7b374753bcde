"""Which result each stage is: the settings that decide it, by which it is found again in the cache.

Flow's gaps, and how many points are linked, follow the time there was: links are known by their record.
"""

from __future__ import annotations

import hashlib
import logging
import math
from functools import cached_property
from pathlib import Path
from typing import Any

from decomotion.cache import cache_root
from decomotion.data.config import ISNET
from decomotion.data.flow.config import FolderFlowConfig, RaftFlowConfig
from decomotion.data.links.budget import what_is_thinned
from decomotion.data.links.config import MatchingConfig
from decomotion.data.links.filtering import Grid
from decomotion.data.links.matcher import Matcher
from decomotion.data.links.matching import build_matcher
from decomotion.data.masks import isnet
from decomotion.data.pool import grid_shape
from decomotion.data.prepare.inputs import Inputs
from decomotion.data.stages import Stage, settings_of_finished
from decomotion.errors import DownloadError
from decomotion.files import digest_of

log = logging.getLogger(__name__)

PLACES = {"path", "weights"}
"""Settings of flow that say where files lie: their content counts, not their names."""
VERSIONS = {"frames": 1, "links": 13, "features": 2, "filter": 1, "motion": 6}
"""Raised for a stage whenever the same clip and settings would give another result."""


class Keys:
    """The stages of a preparation, not necessarily made yet."""

    def __init__(self, inputs: Inputs) -> None:
        self.inputs = inputs
        self.networks: Matcher | None = None
        """Of the matches, where `matching` had to see whether they can be had."""
        self.root = cache_root() / inputs.clip.digest()

    def stage(self, name: str, **settings: Any) -> Stage:
        """The one of that name whose content these settings decide, beside the clip."""
        versioned = {"version": VERSIONS[name], "clip": self.inputs.clip.digest(), **settings}
        return Stage(name, versioned, self.root)

    @cached_property
    def links(self) -> Stage:
        """Those that are finished already where they are no worse than what is asked for."""
        return self.links_with(self.matching)

    def links_with(self, matching: MatchingConfig) -> Stage:
        """As `links`, with matches of these settings."""
        inputs, config = self.inputs, self.inputs.config
        asked = self.stage(
            "links",
            flow=config.flow.model_dump(mode="json", exclude=PLACES),
            given=self.digest_of_flow(),
            budget=config.prepare_budget if isinstance(config.flow.intervals, str) else None,
            points=inputs.count,
            seed=inputs.seed,
            cycle_threshold=config.pool.cycle_threshold,
            max_gap=config.pool.max_gap,
            matching=matching.model_dump(mode="json", exclude={"weights"}),
            match_weights=[file_digest(Path(file)) for file in matching.weights],
            tracks=None if inputs.tracks is None else inputs.tracks.digest(),
            masks=self.masks_of_links(),
        )
        return asked if inputs.rebuild or asked.finished else self.no_worse(asked) or asked

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
        """Those at the points of `links`."""
        config = self.inputs.config
        return self.stage(
            "features",
            kind=config.features,
            weights=None if config.feature_weights is None else file_digest(Path(config.feature_weights)),
            size=config.feature_size,
            grid=[self.grid.rows, self.grid.columns],
            seed=self.inputs.seed,
            tracks=None if self.inputs.tracks is None else self.inputs.tracks.digest(),
        )

    @cached_property
    def filter(self) -> Stage:
        """Of `links` by `features`."""
        rules = self.inputs.config.rules.model_dump(mode="json")
        return self.stage("filter", links=self.links.made, features=self.features.key, rules=rules)

    @cached_property
    def motion(self) -> Stage:
        """By `links`, filtered where rules are on."""
        given = self.inputs.given_masks
        return self.stage(
            "motion",
            seed=self.inputs.seed,
            links=self.filter.key if self.inputs.filters_on else self.links.made,
            kind=self.masks if given is None else "given",
            given=None if given is None else given.digest,
        )

    def masks_of_links(self) -> str | None:
        """Which masks hold what flow follows by itself; None: it does not."""
        if self.inputs.finds_masks_of_links:
            return self.masks
        return None if self.inputs.masks_of_links is None else self.inputs.masks_of_links.digest

    @cached_property
    def masks(self) -> str:
        """The kind of the masks, with the hash of the network's file: `auto` where its weights can be had nowhere."""
        config = self.inputs.config
        if not config.outlines:
            return config.masks
        if config.masks != ISNET:
            return f"{ISNET} {file_digest(Path(config.masks))}"
        try:
            isnet.file_of(None)
        except DownloadError as error:
            log.warning("%s; until then masks are those of --masks auto, which lack thin parts", error)
            return "auto"
        return ISNET

    @property
    def outlines(self) -> bool:
        """Whether a network draws the masks' outlines."""
        return self.masks.startswith(ISNET)

    def digest_of_flow(self) -> str | None:
        """Hash of the files that decide the flow beside the settings."""
        flow = self.inputs.config.flow
        if isinstance(flow, RaftFlowConfig) and flow.weights is not None:
            return file_digest(Path(flow.weights))
        if isinstance(flow, FolderFlowConfig):
            return folder_digest(Path(flow.path))
        return None

    @cached_property
    def matching(self) -> MatchingConfig:
        """Settings of the matches: dense SIFT's where the weights for others can be had nowhere."""
        wanted = self.inputs.config.matching
        if not wanted.intervals:
            return wanted.model_copy(update={"kind": "sift", "weights": ()})
        if wanted.kind == "sift" or (not self.inputs.rebuild and self.links_with(wanted).finished):
            return wanted
        try:
            self.networks = build_matcher(wanted, self.inputs.device)
        except DownloadError as error:
            log.warning("%s; until then dense SIFT's are taken, which find less of what moves fast", error)
            return wanted.model_copy(update={"kind": "sift"})
        return wanted

    @cached_property
    def matcher(self) -> Matcher:
        """Of `matching`."""
        matching = self.matching
        return self.networks or build_matcher(matching, self.inputs.device)

    @cached_property
    def grid(self) -> Grid:
        """The jittered grid of the points that were linked."""
        rows, columns = self.links.record(cached=True).facts["grid"]
        return Grid(rows, columns, *self.inputs.sides)

    @cached_property
    def thinned(self) -> str | None:
        """What of the finished links there was no time for, in a line; None: nothing."""
        inputs, linked = self.inputs, (self.grid.rows, self.grid.columns)
        points = inputs.count if linked == grid_shape(*inputs.sides, inputs.count) else math.prod(linked)
        intervals = self.links.record(cached=True).facts["intervals"]
        return what_is_thinned(inputs.config, len(inputs.clip), intervals, points, inputs.count)


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

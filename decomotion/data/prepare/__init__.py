"""From a clip to its supervision: a list of stages, each kept in the cache, read together as one pool.

`inputs.py` has what they are made from, `keys.py` which result each stage is, `making.py` how each is made.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass
from pathlib import Path

from decomotion.cache import cache_root as cache_root
from decomotion.clip import Clip
from decomotion.data.config import FIT_SHARE, DataConfig
from decomotion.data.links.intervals import pairs_of
from decomotion.data.pool import Pool, open_pool
from decomotion.data.prepare.inputs import Inputs
from decomotion.data.prepare.keys import Keys
from decomotion.data.prepare.making import Making
from decomotion.data.stages import Record, remove_abandoned
from decomotion.errors import SupervisionError
from decomotion.memory import give_back

log = logging.getLogger(__name__)


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
    inputs = Inputs(clip, config, seed, rebuild, progress, device)
    keys = Keys(inputs)
    making = Making(inputs, keys)
    remove_abandoned(keys.root)
    _check(inputs, keys, making)
    records = [keys.links.run(making.build_links, rebuild), keys.features.run(making.build_features, rebuild)]
    if inputs.filters_on:
        records.append(keys.filter.run(making.build_filter, rebuild))
    records.append(keys.motion.run(making.build_motion, rebuild))
    give_back()
    pool = open_pool([record.folder for record in records], inputs.longer_side, keys.thinned)
    return Preparation(pool, tuple(records), keys.root, (keys.grid.rows, keys.grid.columns))


def affordable(
    clip: Clip, config: DataConfig, seconds: float, *, seed: int = 0, rebuild: bool = False, device: str = "cpu"
) -> DataConfig:
    """`config` for a fit of so many seconds: with less of a budget where preparation would leave the fit too little.

    Links that are in the cache cost nothing: a `config` that has some stays, unless they are to be rebuilt, and where
    some are there that were made with a longer budget than there would be, theirs is taken. Raises `SupervisionError`
    where outlines by a network leave no time.
    """
    inputs = Inputs(clip, config, seed, rebuild, device=device)
    keys = Keys(inputs)
    outlines = Making(inputs, keys).seconds_of_outlines()
    share = FIT_SHARE * seconds - outlines
    if share <= 0:
        enough = math.ceil((outlines + config.prepare_budget) / FIT_SHARE)
        raise SupervisionError(
            f"outlines of {len(clip)} frames by --masks {config.masks} take about {math.ceil(outlines)} seconds, too "
            f"many for a fit of {seconds:g}; give --time-budget {enough}s or longer for each window, a part, CLIP@A:B, "
            "or --masks auto"
        )
    if share >= config.prepare_budget or (not rebuild and keys.links.finished):
        return config
    shorter = config.model_copy(update={"prepare_budget": share})
    links = Keys(Inputs(clip, shorter, seed, rebuild)).links
    return shorter.model_copy(update={"prepare_budget": max(share, links.settings["budget"] or share)})


def _check(inputs: Inputs, keys: Keys, making: Making) -> None:
    """Reads all that the user gives and loads the networks that will be needed, before any long work."""
    config, rebuild = inputs.config, inputs.rebuild
    _ = inputs.given_masks, inputs.tracks
    if inputs.count < config.pool.points_per_frame:
        what = "%d MiB have room for %d of %d points a frame; for all of them raise data.pool.disk_limit"
        log.warning(what, config.pool.disk_limit, inputs.count, config.pool.points_per_frame)
    if config.feature_weights is not None and not Path(config.feature_weights).is_file():
        raise SupervisionError(f"--feature-weights {config.feature_weights} does not exist")
    if rebuild or not keys.links.finished:
        _ = keys.matcher
        inputs.estimator.require(pairs_of((1,), len(inputs.clip)))
    if rebuild or not keys.links.finished or not keys.features.finished:
        _ = inputs.extractor
    if making.outlines_wanted:
        _ = making.network

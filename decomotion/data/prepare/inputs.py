"""What a preparation is made from: the clip, its settings, what the user gives, and the networks."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path

from decomotion.clip import Clip
from decomotion.data.config import DataConfig
from decomotion.data.features import FeatureExtractor, build_features
from decomotion.data.features.interface import MOST_CHANNELS
from decomotion.data.flow import FlowEstimator, build_flow
from decomotion.data.flow.config import DisFlowConfig
from decomotion.data.links.costs import MIN_POINTS
from decomotion.data.links.tracks import UserTracks, read_tracks
from decomotion.data.masks.folder import MaskFiles, read_masks
from decomotion.data.pool import affordable_points
from decomotion.errors import SupervisionError


class Inputs:
    """Of one clip; what takes time, or may be wrong, is read when it is asked for."""

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
        self.sides, self.longer_side = (clip.height, clip.width), max(clip.height, clip.width)
        """Of the clip, in pixels."""
        rules = config.rules
        self.filters_on = any(rule is not None for rule in (rules.cycle, rules.appearance, rules.second_look))

    @cached_property
    def estimator(self) -> FlowEstimator:
        """Of flow."""
        return build_flow(self.config.flow, self.device)

    @cached_property
    def extractor(self) -> FeatureExtractor | None:
        """Of features; None: there are none."""
        return build_features(self.config, self.device)

    @cached_property
    def given_masks(self) -> MaskFiles | None:
        """The user's; None where they give none."""
        if not self.config.gives_masks:
            return None
        return read_masks(Path(self.config.masks), len(self.clip), self.clip.height, self.clip.width)

    @property
    def masks_of_links(self) -> MaskFiles | None:
        """Given masks, where flow is to follow by itself what they hold."""
        return self.given_masks if self._alone else None

    @property
    def finds_masks_of_links(self) -> bool:
        """Whether flow is to follow by itself what is found to move."""
        return self.config.finds_masks and self._alone

    @property
    def _alone(self) -> bool:
        flow = self.config.flow
        return isinstance(flow, DisFlowConfig) and flow.alone

    @cached_property
    def tracks(self) -> UserTracks | None:
        """Likewise."""
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

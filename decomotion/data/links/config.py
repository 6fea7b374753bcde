"""Settings of links: the pool of them, matches by appearance, and second thoughts."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from decomotion.leaf import Leaf


class PoolConfig(Leaf):
    """The pool of correspondences that the fit draws from."""

    points_per_frame: int = Field(ge=16)
    """Points of each frame that are linked to all other frames."""
    disk_limit: int = Field(ge=1)
    """MiB that the pool may take on disk: a long clip gets fewer points a frame."""
    cycle_threshold: float = Field(gt=0)
    """Forward-backward error in pixels of a 256-pixel frame above which a hop counts as an occlusion."""
    max_gap: int = Field(ge=1)
    """Longest frame gap that is linked."""


class MatchingConfig(Leaf):
    """Matches by appearance, for what flow loses (`matching.py`)."""

    kind: Literal["sift", "xfeat", "aliked"] = "sift"
    """Dense SIFT, which needs no weights; or keypoints of XFeat or ALIKED, matched by LightGlue."""
    weights: tuple[str, ...] = ()
    """Files of weights for `xfeat` or `aliked`: the extractor's and LightGlue's; empty: their publishers', by
    download, or `sift` where that fails."""
    intervals: tuple[int, ...]
    """Frame gaps that are matched; empty: none."""
    supporters: int = Field(ge=0, le=24)
    """Of the 24 cells around a match of `sift`, how many have to move likewise for it to be trusted."""

    @model_validator(mode="after")
    def _consistent(self) -> MatchingConfig:
        if self.weights and self.kind == "sift":
            raise ValueError("weights go with matches xfeat or aliked, not sift")
        return self


class FilterConfig(Leaf):
    """Second thoughts about the links, as in OmniMotion (`filtering.py`)."""

    cycle: float | None = Field(gt=0)
    """Links whose way there and back misses by more than this, in pixels of a 256-pixel frame, go; null: none."""
    appearance: float | None = Field(ge=-1, le=1)
    """Links to a place whose feature has a smaller cosine similarity are dropped; null, or without features: none."""
    appearance_gap: int = Field(ge=1)
    """The shortest frame gap at which `appearance` looks."""
    second_look: float | None = Field(gt=0, le=1)
    """Confidence given to links onto hidden places that a second cycle confirms; null: they stay unknown."""
    second_look_gap: int = Field(ge=1)
    """The longest frame gap of these."""

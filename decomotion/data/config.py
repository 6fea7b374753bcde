"""Settings of what is prepared from a clip."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field, model_validator

from decomotion.data.flow.config import AnyFlowConfig
from decomotion.data.links.config import FilterConfig, MatchingConfig, PoolConfig
from decomotion.leaf import Leaf

FIT_SHARE = 0.75
"""Share of a fit's time that preparation should take at most."""

ISNET = "isnet"
"""Of `masks`: by its publisher's weights."""


class DataConfig(Leaf):
    """What is prepared from the clip before the fit."""

    prepare_budget: float = Field(gt=0)
    """Seconds that preparation should take at most: decides at how many gaps flow is computed, and how many
    points are linked; a clip that takes longer all the same is refused."""
    flow: AnyFlowConfig
    pool: PoolConfig
    matching: MatchingConfig
    filters: FilterConfig
    tracks: str | None
    """File of tracks from any tracker (`docs/formats.md`), as further correspondences; null: none."""
    features: Literal["densesift", "aliked", "dino", "none"]
    """Dense features to render: kornia's dense SIFT, which needs no weights, its ALIKED, DINO (timm), or none."""
    feature_weights: str | None
    """File of weights for `aliked` or `dino`; null: their publishers', by download."""
    feature_size: int = Field(ge=0)
    """Features are reduced by PCA to this many channels; 0 keeps them all."""
    masks: str
    """`auto` (what the camera's motion does not explain), `isnet` (that, with outlines by IS-Net, whose weights are
    its publisher's, by download, or of a file FILE.onnx), `none`, or a folder of mask images (white: moving)."""

    @model_validator(mode="after")
    def _consistent(self) -> DataConfig:
        if self.feature_weights is not None and self.features not in ("aliked", "dino"):
            raise ValueError(f"feature_weights go with features aliked or dino, not {self.features}")
        return self

    @property
    def outlines(self) -> bool:
        """Whether a network draws the outlines of masks that are found."""
        return self.masks == ISNET or Path(self.masks).suffix == ".onnx"

    @property
    def finds_masks(self) -> bool:
        """Whether links tell what moves."""
        return self.masks == "auto" or self.outlines

    @property
    def gives_masks(self) -> bool:
        """Whether masks are the user's own."""
        return self.masks != "none" and not self.finds_masks

    @property
    def rules(self) -> FilterConfig:
        """The filters that are laid on the links: without features, none that compares them."""
        return self.filters if self.features != "none" else self.filters.model_copy(update={"appearance": None})

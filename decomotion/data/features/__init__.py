"""Dense features to render: what a point looks like, more discriminatively than its colour."""

from __future__ import annotations

from decomotion.data.config import DataConfig
from decomotion.data.features.interface import FeatureExtractor
from decomotion.errors import SupervisionError
from decomotion.extras import remedy

__all__ = ["FeatureExtractor", "build_features"]


def build_features(config: DataConfig, device: str = "cpu") -> FeatureExtractor | None:
    """The extractor that `config` names; those with weights load them here and run on `device`; None for none.

    Raises `SupervisionError` where the weights are missing or do not fit, or a library is not installed.
    """
    if config.features == "densesift":
        from decomotion.data.features.densesift import DenseSift

        return DenseSift()
    if config.features == "aliked":
        from decomotion.data.features.aliked import AlikedFeatures

        return AlikedFeatures(config.feature_weights, device)
    if config.features == "dino":
        try:
            from decomotion.data.features.dino import DinoFeatures
        except ModuleNotFoundError as error:
            if error.name != "timm":
                raise
            raise SupervisionError(
                f"features dino need timm, which is not installed; run: {remedy('timm')}, or take --features densesift"
            ) from error
        return DinoFeatures(config.feature_weights, device)
    return None

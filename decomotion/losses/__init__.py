"""The losses by name. A new one is a file here, an entry in `LOSSES`, a line of YAML and a test.

Each entry says which parts of the prediction and of the batch its function looks at; the configuration's `loss`
section says how much it weighs and when. M is the motion mask, 1 on what moves; where there is none, the losses that
it guides have weight 0 and the fused ones decide alone.
"""

from __future__ import annotations

from collections.abc import Callable

from jaxtyping import Float
from torch import Tensor

from decomotion.config import Schedule
from decomotion.data.batch import Batch
from decomotion.errors import ConfigError
from decomotion.losses.depth_range import depth_range_loss
from decomotion.losses.distortion import distortion_loss
from decomotion.losses.feature import feature_loss
from decomotion.losses.flow import flow_loss
from decomotion.losses.photometric import photometric_loss
from decomotion.losses.robust_flow import robust_flow_loss
from decomotion.losses.scene_flow import scene_flow_loss
from decomotion.losses.segmentation import segmentation_loss
from decomotion.model.fusion import Prediction
from decomotion.pseudo_depth import FAR, NEAR
from decomotion.schedule import value_at

Loss = Callable[[Prediction, Batch], Float[Tensor, ""]]

LOSSES: dict[str, Loss] = {
    "flow_dynamic": lambda p, b: flow_loss(p.dynamic_xy, b.target_xy, b.confidence * b.moving),
    "flow_static": lambda p, b: flow_loss(p.static_xy, b.target_xy, b.confidence * (b.masked - b.moving)),
    "flow_fused": lambda p, b: flow_loss(p.fused_xy, b.target_xy, b.confidence),
    "flow_robust": lambda p, b: robust_flow_loss(p.fused_xy, b.target_xy, b.confidence),
    "photometric_dynamic": lambda p, b: photometric_loss(p.dynamic_rgb, b.rgb, b.moving),
    "photometric_static": lambda p, b: photometric_loss(p.static_rgb, b.rgb, b.masked - b.moving),
    "photometric_fused": lambda p, b: photometric_loss(p.fused_rgb, b.rgb, b.moving.new_ones(b.moving.shape)),
    "feature": lambda p, b: feature_loss(p.dynamic_feature, b.feature, b.moving),
    "segmentation": lambda p, b: segmentation_loss(p.static_confidence, b.moving, b.masked),
    "scene_flow": lambda p, b: scene_flow_loss(p.acceleration),
    "distortion": lambda p, b: (
        distortion_loss(p.static_weights, p.depths, NEAR, FAR) + distortion_loss(p.dynamic_weights, p.depths, NEAR, FAR)
    ),
    "depth_range": lambda p, b: (
        depth_range_loss(p.static_depths, NEAR, FAR) + depth_range_loss(p.dynamic_depths, NEAR, FAR)
    ),
}

OF_STATIC = {"flow_static", "photometric_static", "segmentation"}
OF_DYNAMIC = {"flow_dynamic", "photometric_dynamic", "feature", "segmentation"}
LEFT_OUT = {"fused": set[str](), "static": OF_DYNAMIC, "dynamic": OF_STATIC}
"""By `model.volumes`, the losses that look at a volume which is not there."""


def applicable(weights: dict[str, float | Schedule], volumes: str) -> dict[str, float | Schedule]:
    """The losses that a model of these `volumes` can have."""
    return {name: weight for name, weight in weights.items() if name not in LEFT_OUT[volumes]}


def check(weights: dict[str, float | Schedule], volumes: str) -> None:
    """Raises `ConfigError` where the configuration weighs a loss that does not exist, or at some time weighs none."""
    for name in weights:
        if name not in LOSSES:
            raise ConfigError(f"loss.{name} is not a loss; there are {', '.join(LOSSES)}")
    usable = applicable(weights, volumes).values()
    turns = {turn for each in usable if isinstance(each, Schedule) for turn in (each.begin, each.end)}
    for progress in sorted({0.0, *turns} - {1.0}):  # between two of these no weight falls to 0
        if not any(value_at(weight, progress) > 0 for weight in usable):
            raise ConfigError(f"no loss has a weight above 0 at {progress:.0%} of the run; give one of loss.* such")

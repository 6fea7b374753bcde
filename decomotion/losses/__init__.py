"""The losses by name. A new one is a file here, an entry in `LOSSES`, a line of YAML and a test.

Each entry says which parts of the prediction and of the batch its function looks at; the configuration's `loss`
section says how much it weighs and when. M is the motion mask, 1 on what moves; where there is none, the losses that
it guides have weight 0 and the fused ones decide alone.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

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
from decomotion.schedule import Schedule, value_at


class Loss(NamedTuple):
    """One term of the sum."""

    value: Callable[[Prediction, Batch], Float[Tensor, ""]]
    """What its function is given."""
    volumes: tuple[str, ...] = ()
    """Those of `static` and `dynamic` that it looks at alone: where one of them is not there, the loss is left out."""

    def __call__(self, prediction: Prediction, batch: Batch) -> Float[Tensor, ""]:
        """The loss before it is weighted."""
        return self.value(prediction, batch)


S, D = ("static",), ("dynamic",)

LOSSES = {
    "flow_dynamic": Loss(lambda p, b: flow_loss(p.dynamic_xy, b.target_xy, b.confidence * b.moving), D),
    "flow_static": Loss(lambda p, b: flow_loss(p.static_xy, b.target_xy, b.confidence * (b.masked - b.moving)), S),
    "flow_fused": Loss(lambda p, b: flow_loss(p.fused_xy, b.target_xy, b.confidence)),
    "flow_robust": Loss(lambda p, b: robust_flow_loss(p.fused_xy, b.target_xy, b.confidence)),
    "flow_hidden": Loss(
        lambda p, b: (
            robust_flow_loss(p.dynamic_xy, b.expected_xy, b.expected_weight * b.moving)
            + robust_flow_loss(p.static_xy, b.expected_xy, b.expected_weight * (b.masked - b.moving))
        ),
        S + D,
    ),
    "photometric_dynamic": Loss(lambda p, b: photometric_loss(p.dynamic_rgb, b.rgb, b.moving), D),
    "photometric_static": Loss(lambda p, b: photometric_loss(p.static_rgb, b.rgb, b.masked - b.moving), S),
    "photometric_fused": Loss(lambda p, b: photometric_loss(p.fused_rgb, b.rgb, torch.ones_like(b.moving))),
    "feature": Loss(lambda p, b: feature_loss(p.dynamic_feature, b.feature, b.moving), D),
    "segmentation": Loss(lambda p, b: segmentation_loss(p.motion_mask, b.moving, b.masked), S + D),
    "scene_flow": Loss(lambda p, b: scene_flow_loss(p.acceleration)),
    "distortion": Loss(
        lambda p, b: (
            distortion_loss(p.static_weights, p.depths, NEAR, FAR)
            + distortion_loss(p.dynamic_weights, p.depths, NEAR, FAR)
        )
    ),
    "depth_range": Loss(
        lambda p, b: depth_range_loss(p.static_depths, NEAR, FAR) + depth_range_loss(p.dynamic_depths, NEAR, FAR)
    ),
}


def applicable(weights: dict[str, float | Schedule], volumes: str) -> dict[str, float | Schedule]:
    """The losses that a model of these `volumes` can have."""
    missing = {"fused": set(), "static": set(D), "dynamic": set(S)}[volumes]
    return {name: weight for name, weight in weights.items() if missing.isdisjoint(LOSSES[name].volumes)}


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

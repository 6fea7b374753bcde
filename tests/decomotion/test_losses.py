"""Losses, by hand and against nested loops."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from decomotion.config import load
from decomotion.data.batch import Batch
from decomotion.errors import ConfigError
from decomotion.losses import LOSSES, check
from decomotion.losses.depth_range import depth_range_loss
from decomotion.losses.distortion import distortion_loss
from decomotion.losses.feature import feature_loss
from decomotion.losses.flow import flow_loss
from decomotion.losses.photometric import photometric_loss
from decomotion.losses.robust_flow import SCALE, robust_flow_loss
from decomotion.losses.scene_flow import scene_flow_loss
from decomotion.losses.segmentation import segmentation_loss
from decomotion.model.fusion import Prediction
from decomotion.presets import PRESETS
from tiny_fit import offsets, randomised, tiny_model


def pair_of_points(*values: list[float]) -> Tensor:
    """[1 pair, point, channel]."""
    return torch.tensor(values)[None]


def weights(*values: float) -> Tensor:
    return torch.tensor(values)[None]


class TestFlow:
    predicted, target = pair_of_points([1.0, 2.0], [5.0, 5.0]), pair_of_points([4.0, -2.0], [5.0, 6.0])

    def test_by_hand(self):
        # L1 distances 3 + 4 = 7 and 1; (7 * 0.5 + 1 * 1) / 2 points
        assert flow_loss(self.predicted, self.target, weights(0.5, 1.0)).item() == 2.25

    def test_zero_confidence(self):
        predicted = self.predicted.clone().requires_grad_()
        loss = flow_loss(predicted, self.target, weights(0.0, 0.0))
        loss.backward()
        assert loss.item() == 0
        assert predicted.grad is not None
        assert not predicted.grad.any()


class TestRobustFlow:
    def test_zero_where_all_is_right(self):
        xy = torch.rand(2, 3, 2)
        assert robust_flow_loss(xy, xy, torch.ones(2, 3)) == 0

    def test_by_hand(self):
        """Distances SCALE and 3 SCALE, of weights 1 and a half; a third point does not count."""
        target = torch.zeros(1, 3, 2)
        predicted = torch.tensor([[[SCALE, 0.0], [SCALE, -2 * SCALE], [9.0, 9.0]]])
        loss = robust_flow_loss(predicted, target, torch.tensor([[1.0, 0.5, 0.0]]))
        assert loss.item() == pytest.approx(SCALE * (math.log(2) + 0.5 * math.log(4)) / 3)

    def test_the_pull_halves_at_the_scale(self):
        predicted = torch.tensor([[[0.0, 1e-6], [SCALE, 0.0]]], requires_grad=True)
        robust_flow_loss(predicted, torch.zeros(1, 2, 2), torch.ones(1, 2)).backward()
        assert predicted.grad is not None
        pull = predicted.grad.abs().sum(-1)[0]
        assert (pull[1] / pull[0]).item() == pytest.approx(0.5, rel=1e-3)


class TestPhotometric:
    def test_by_hand(self):
        rendered = pair_of_points([0.5, 0.0, 1.0], [0.0, 0.0, 0.0])
        rgb = pair_of_points([0.0, 0.5, 1.0], [1.0, 1.0, 1.0])
        # squared distances 0.5 and 3
        assert photometric_loss(rendered, rgb, weights(1.0, 0.5)).item() == 1.0
        assert photometric_loss(rendered, rgb, weights(0.0, 0.0)).item() == 0.0


class TestFeature:
    def test_by_hand(self):
        rendered, feature = pair_of_points([1.0, 0.0], [0.0, 0.0]), pair_of_points([0.0, 1.0], [0.0, 0.5])
        # mean absolute differences 1 and 0.25
        assert feature_loss(rendered, feature, weights(0.5, 1.0)).item() == 0.375

    def test_no_channels(self):
        assert feature_loss(torch.zeros(2, 3, 0), torch.zeros(2, 3, 0), torch.ones(2, 3)).item() == 0


class TestSegmentation:
    @pytest.mark.parametrize("moving", [0.0, 1.0])
    def test_certain_and_right_costs_nothing(self, moving: float):
        # confidences are kept 1e-4 from 0 and 1
        loss = segmentation_loss(weights(1 - moving), weights(moving), weights(1.0)).item()
        assert loss == pytest.approx(0, abs=2e-4)

    @pytest.mark.parametrize("moving", [0.0, 1.0])
    def test_certain_and_wrong_costs_much_but_not_all(self, moving: float):
        loss = segmentation_loss(weights(moving), weights(moving), weights(1.0)).item()
        assert loss == pytest.approx(-math.log(1e-4), rel=1e-3)

    def test_by_hand(self):
        loss = segmentation_loss(weights(0.25, 0.25, 0.1), weights(0.0, 1.0, 1.0), weights(1.0, 1.0, 0.0))
        assert loss.item() == pytest.approx(-(math.log(0.25) + math.log(0.75)) / 3)

    def test_gradient_leads_to_the_mask(self):
        confidence = weights(0.5, 0.5).requires_grad_()
        segmentation_loss(confidence, weights(0.0, 1.0), weights(1.0, 1.0)).backward()
        assert confidence.grad is not None
        assert confidence.grad[0, 0] < 0 < confidence.grad[0, 1]


class TestDistortion:
    @pytest.mark.parametrize("batch", [(), (3,), (2, 3)])
    def test_against_nested_loops(self, batch: tuple[int, ...]):
        generator = torch.Generator().manual_seed(0)
        w = torch.rand(*batch, 5, generator=generator, dtype=torch.float64)
        depths = torch.rand(*batch, 5, generator=generator, dtype=torch.float64).sort(dim=-1).values * 2
        rays = list(zip(w.reshape(-1, 5), depths.reshape(-1, 5), strict=True))
        total = 0.0
        for weight, depth in rays:
            for a in range(5):
                total += weight[a].item() ** 2 / (3 * 5)
                for b in range(5):
                    total += (weight[a] * weight[b] * abs(depth[a] - depth[b]) / 2).item()
        assert distortion_loss(w, depths, 0.0, 2.0).item() == pytest.approx(total / len(rays))

    def test_least_on_one_surface(self):
        depths = torch.tensor([0.25, 0.75, 1.25, 1.75])
        spread, gathered = torch.tensor([0.5, 0.0, 0.0, 0.5]), torch.tensor([0.0, 1.0, 0.0, 0.0])
        assert distortion_loss(gathered, depths, 0.0, 2.0) < distortion_loss(spread, depths, 0.0, 2.0)
        assert distortion_loss(gathered, depths, 0.0, 2.0).item() == pytest.approx(1 / 12)


class TestRegularisers:
    def test_depth_range_by_hand(self):
        depths = torch.tensor([[-0.5, 0.0, 1.0], [2.0, 3.0, 0.5]])
        assert depth_range_loss(depths, 0.0, 2.0).item() == pytest.approx((0.25 + 1) / 6)

    def test_scene_flow_by_hand(self):
        acceleration = torch.tensor([[[1.0, -2.0, 0.0], [0.0, 0.0, 0.5]]])[None]
        assert scene_flow_loss(acceleration).item() == pytest.approx((3 + 0.5) / 2)

    def test_scene_flow_of_one_point(self):
        assert scene_flow_loss(torch.tensor([[[[0.5, -0.25, 1.0]]]])).item() == 1.75

    def test_scene_flow_of_no_points_is_zero(self):
        assert scene_flow_loss(torch.zeros(2, 0, 4, 3)).item() == 0


@pytest.mark.parametrize("preset", PRESETS)
def test_presets_name_losses_that_there_are(preset: str):
    assert set(load(preset).loss) <= set(LOSSES)
    assert set(load("cpu").loss) == set(LOSSES)


def test_an_unknown_loss_is_named():
    check({"flow_fused": 1.0}, "fused")
    with pytest.raises(ConfigError, match=r"loss\.flow_fussed is not a loss; .*flow_fused"):
        check({"flow_fussed": 1.0}, "fused")


def drawn(shape: tuple[int, ...], seed: int) -> Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed))


def an_example() -> tuple[Prediction, Batch]:
    """An unfitted model's prediction; confidence and mask differ from point to point, some points have no mask."""
    shape = (2, 6)
    xy = 20 * drawn((*shape, 2), 0)
    masked = (drawn(shape, 1) > 0.3).float()
    batch = Batch(
        frame=torch.tensor([0, 3]),
        target_frame=torch.tensor([1, 4]),
        point=torch.zeros(shape, dtype=torch.int64),
        xy=xy,
        target_xy=xy + 3,
        confidence=drawn(shape, 2),
        rgb=drawn((*shape, 3), 3),
        feature=drawn((*shape, 3), 4),
        moving=masked * drawn(shape, 5),
        masked=masked,
        expected_xy=xy - 5 * drawn((*shape, 2), 6),
        expected_weight=drawn(shape, 7),
    )
    model = randomised(tiny_model("cpu"), 0.3)
    return model.predict(xy, batch.frame, batch.target_frame, offsets(model, xy)), batch


def test_every_loss_is_what_its_equation_says():
    """Written out (paper, Eq. 6 to 13), so that each is known to look at its own volume, weights and mask."""
    p, b = an_example()
    p = replace(p, static_depths=1.7 * p.static_depths, dynamic_depths=p.dynamic_depths - 1.2)  # beyond either end
    c, moving, still = b.confidence, b.moving, b.masked - b.moving

    def away(xy: Tensor) -> Tensor:
        return (xy - b.target_xy).abs().sum(-1)

    def unlike(rgb: Tensor) -> Tensor:
        return (rgb - b.rgb).square().sum(-1)

    def spread(weights: Tensor) -> Tensor:
        return distortion_loss(weights, p.depths, 0.0, 2.0)

    def beyond(depths: Tensor) -> Tensor:
        return (depths - depths.clamp(0, 2)).square().mean()

    def surprising(xy: Tensor) -> Tensor:
        return b.expected_weight * 2 * torch.log1p((xy - b.expected_xy).abs().sum(-1) / 2)

    expected = {
        "flow_hidden": (moving * surprising(p.dynamic_xy) + still * surprising(p.static_xy)).mean(),
        "flow_dynamic": (c * moving * away(p.dynamic_xy)).mean(),
        "flow_static": (c * still * away(p.static_xy)).mean(),
        "flow_fused": (c * away(p.fused_xy)).mean(),
        "flow_robust": (c * 2 * torch.log1p(away(p.fused_xy) / 2)).mean(),
        "photometric_dynamic": (moving * unlike(p.dynamic_rgb)).mean(),
        "photometric_static": (still * unlike(p.static_rgb)).mean(),
        "photometric_fused": unlike(p.fused_rgb).mean(),
        "feature": (moving * (p.dynamic_feature - b.feature).abs().mean(-1)).mean(),
        "segmentation": -(still * p.motion_mask.log() + moving * (1 - p.motion_mask).log()).mean(),
        "scene_flow": p.acceleration.abs().sum(-1).mean(),
        "distortion": spread(p.static_weights) + spread(p.dynamic_weights),
        "depth_range": beyond(p.static_depths) + beyond(p.dynamic_depths),
    }
    assert set(expected) == set(LOSSES)
    assert all(value > 0 for value in expected.values())
    for name, value in expected.items():
        torch.testing.assert_close(LOSSES[name](p, b), value, rtol=2e-3, atol=1e-6)


def test_without_a_mask_the_fused_losses_decide_alone():
    prediction, batch = an_example()
    batch = replace(batch, moving=torch.zeros(2, 6), masked=torch.zeros(2, 6))
    values = {name: loss(prediction, batch).item() for name, loss in LOSSES.items()}
    guided = ("flow_dynamic", "flow_static", "photometric_dynamic", "photometric_static", "feature", "segmentation")
    assert not any(values[name] for name in guided)
    assert values["flow_fused"] > 0
    assert values["photometric_fused"] > 0

"""The fused model: its two ends, its feature, and that neither order nor company of frames matters."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from decomotion.compositing import composite
from decomotion.geometry import ImagePlane
from decomotion.model.fusion import MAX_EXTENT, DecoMotion, PairConditioning, canonical_extent
from decomotion.model.readout import carry, surface_of
from decomotion.rays import sample_depths
from tiny_fit import offsets, randomised, tiny_model

FRAMES = 5

both_presets = pytest.mark.parametrize("preset", ["cpu", "paper"])


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def random_pixels(pairs: int, points: int) -> Tensor:
    return torch.rand(pairs, points, 2, generator=generator()) * torch.tensor([31.0, 23.0])


def random_units(pairs: int, points: int) -> Tensor:
    """The same places on the raster whose longer side is 256: 8 units to a pixel."""
    return 8 * (random_pixels(pairs, points) + 0.5) - 0.5


def with_confidence(model: DecoMotion, logit: float) -> DecoMotion:
    """The model with one static confidence everywhere."""
    with torch.no_grad():
        model.static.head.weight[4] = 0
        model.static.head.bias[4] = logit
    return model


def carrying(model: DecoMotion, deferred: bool) -> DecoMotion:
    """The model, told what of its rays it carries to other frames."""
    model.config = model.config.model_copy(update={"deferred": deferred})
    return model


@both_presets
@pytest.mark.parametrize("frames", [2, 3, 5])
@pytest.mark.parametrize("features", [0, 3])
def test_prediction_at_all_sizes(preset: str, frames: int, features: int):
    """Shapes are checked by their annotations."""
    model = randomised(tiny_model(preset, frames=frames, feature_size=features), 0.05)
    frame, target = torch.tensor([0, frames - 1, 0]), torch.tensor([frames - 1, 0, 1])
    xy = random_units(3, 7)
    prediction = model.predict(xy, frame, target, offsets(model, xy), smooth_points=2)
    assert prediction.fused_xy.shape == (3, 7, 2)
    assert prediction.dynamic_feature.shape == (3, 7, features)
    carried = 1 if model.config.deferred else model.config.samples
    assert prediction.acceleration.shape == (3, 2, carried, 3)
    assert bool(prediction.acceleration.any()) == (frames > 2)
    for value in vars(prediction).values():
        assert value.isfinite().all()


@both_presets
def test_full_static_confidence_leaves_the_static_volume(preset: str):
    model = with_confidence(randomised(tiny_model(preset), 0.05), math.inf)
    xy = random_units(2, 6)
    prediction = model.predict(xy, torch.tensor([0, 3]), torch.tensor([4, 1]), offsets(model, xy))
    torch.testing.assert_close(prediction.fused_xy, prediction.static_xy)
    torch.testing.assert_close(prediction.fused_rgb, prediction.static_rgb)
    expected = torch.ones(2, 6) if preset == "cpu" else prediction.static_weights.sum(-1)  # of the volume alone
    torch.testing.assert_close(prediction.motion_mask, expected)


@both_presets
def test_no_static_confidence_leaves_the_dynamic_volume(preset: str):
    model = with_confidence(randomised(tiny_model(preset), 0.05), -math.inf)
    xy = random_units(2, 6)
    prediction = model.predict(xy, torch.tensor([0, 3]), torch.tensor([4, 1]), offsets(model, xy))
    torch.testing.assert_close(prediction.fused_xy, prediction.dynamic_xy)
    torch.testing.assert_close(prediction.fused_rgb, prediction.dynamic_rgb)
    torch.testing.assert_close(prediction.motion_mask, torch.zeros(2, 6))


@both_presets
def test_to_its_own_frame_a_point_stays(preset: str):
    """Where weights are normalised; without that (Eq. 2 as written) a ray's missing weight pulls to the middle."""
    model = randomised(tiny_model(preset), 0.05)
    xy, frame = random_units(2, 6), torch.tensor([0, 3])
    prediction = model.predict(xy, frame, frame, offsets(model, xy))
    opacity = prediction.static_weights.sum(-1, keepdim=True)
    middle = torch.tensor([127.5, 95.5])
    expected = xy if model.config.normalise_weights else middle + (xy - middle) * opacity
    # float32, through three maps and back
    torch.testing.assert_close(prediction.static_xy, expected, rtol=0, atol=8e-3)


def test_deferred_is_exact_where_the_map_is_affine():
    """The mean of mapped samples is the map of the point at their mean depth; the couplings start as the identity."""
    model = tiny_model("cpu", feature_size=0)
    arguments = random_units(3, 7), torch.tensor([0, 3, 1]), torch.tensor([2, 0, 4])
    drawn = offsets(model, arguments[0])
    found = {kind: carrying(model, kind).predict(*arguments, drawn) for kind in (False, True)}
    for name in ("static_xy", "dynamic_xy", "fused_xy"):
        torch.testing.assert_close(getattr(found[True], name), getattr(found[False], name), rtol=0, atol=8e-3, msg=name)


def test_a_deferred_point_is_the_one_that_answers():
    """Where one volume owns the ray, training and readout carry the same point."""
    model = carrying(with_confidence(randomised(tiny_model("cpu"), 0.05), math.inf), deferred=True)
    xy, frame, target = random_pixels(2, 6), torch.tensor([0, 3]), torch.tensor([4, 1])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("decomotion.model.fusion.sample_depths", lambda like, samples, _: sample_depths(like, samples))
        trained = model.predict(8 * (xy + 0.5) - 0.5, frame, target, offsets(model, xy)).fused_xy
    conditioning = model.condition(torch.arange(FRAMES))
    answered = carry(model, surface_of(model, xy, conditioning, frame), conditioning, target)
    torch.testing.assert_close(trained, 8 * (answered + 0.5) - 0.5, rtol=0, atol=8e-3)


@both_presets
def test_the_feature_head_may_come_after_compositing(preset: str):
    """Eq. 3 composites the features of the samples; the head is linear, so it may as well be applied to the sum."""
    model = randomised(tiny_model(preset))
    canonical = torch.randn(2, 6, 4, 3, generator=generator())
    weights = torch.rand(2, 6, 4, generator=generator()) / 4
    field, head = model.feature_field, model.feature_head
    assert field is not None
    assert head is not None
    features = head(field(canonical.reshape(-1, 3))).reshape(2, 6, 4, -1)
    torch.testing.assert_close(
        model._render_feature(weights, canonical), composite(weights, features), rtol=1e-4, atol=1e-5
    )


@both_presets
def test_neither_order_nor_company_of_frames_matters(preset: str):
    model = randomised(tiny_model(preset), 0.05)
    xy, frame = random_pixels(4, 6), torch.tensor([3, 0, 4, 0])
    together = model.cast(xy, model.condition(frame))
    for row in range(4):
        alone = model.cast(xy[row : row + 1], model.condition(frame[row : row + 1]))
        torch.testing.assert_close(alone.static_canonical[0], together.static_canonical[row])
        torch.testing.assert_close(alone.dynamic_canonical[0], together.dynamic_canonical[row])
        torch.testing.assert_close(alone.fused_colour()[0], together.fused_colour()[row])
    looked_up = model.cast(xy, model.condition(torch.arange(FRAMES)), frame)
    torch.testing.assert_close(looked_up.fused_colour(), together.fused_colour(), rtol=1e-4, atol=1e-5)


@both_presets
def test_targets_do_not_depend_on_the_other_pairs(preset: str):
    model = randomised(tiny_model(preset), 0.05)
    xy, frame, target = random_pixels(3, 6), torch.tensor([3, 0, 4]), torch.tensor([0, 4, 1])
    together = model.predict(xy, frame, target, offsets(model, xy))
    first = model.predict(xy[:1], frame[:1], target[:1], offsets(model, xy)[:1])
    torch.testing.assert_close(first.fused_xy[0], together.fused_xy[0], rtol=0, atol=1e-4)
    torch.testing.assert_close(first.acceleration[0], together.acceleration[0], rtol=0, atol=1e-5)


def test_acceleration_is_the_second_difference_about_the_nearest_inner_frame():
    """Every frame's camera is shifted by t^2 / 10: the acceleration is 2 / 10 everywhere, at the clip's ends too."""
    start = torch.eye(3, 4).repeat(FRAMES, 1, 1)
    start[:, 0, 3] = -0.1 * torch.arange(FRAMES) ** 2
    model = tiny_model("cpu", start=start)
    frame = torch.arange(FRAMES)
    xy = random_units(FRAMES, 3)
    prediction = model.predict(xy, frame, frame.flip(0), offsets(model, xy))
    expected = torch.tensor([0.2, 0.0, 0.0]).expand_as(prediction.acceleration)
    torch.testing.assert_close(prediction.acceleration, expected, rtol=0, atol=1e-5)


def test_weights_of_a_ray_sum_to_at_most_one():
    model = randomised(tiny_model("cpu"))
    rays = model.cast(random_pixels(2, 50), model.condition(torch.tensor([0, 1])))
    assert (rays.opacity <= 1 + 1e-5).all()
    assert ((rays.static_confidence >= 0) & (rays.static_confidence <= 1 + 1e-5)).all()


def test_every_parameter_learns():
    model = randomised(tiny_model("cpu"), 0.05)
    frame, target = torch.tensor([0, 1, 2, 3]), torch.tensor([4, 3, 0, 2])
    xy = random_units(4, 60)
    prediction = model.predict(xy, frame, target, offsets(model, xy))
    total = sum((value * torch.randn(value.shape, generator=generator(1))).sum() for value in vars(prediction).values())
    assert isinstance(total, Tensor)
    total.backward()
    idle = [name for name, p in model.named_parameters() if p.grad is None or not p.grad.any()]
    assert idle == []


class TestExtent:
    plane = ImagePlane(height=50, width=100)

    def test_of_identity_maps_is_the_image_with_a_margin(self):
        extent = canonical_extent(torch.eye(3, 4).repeat(2, 1, 1), self.plane)
        torch.testing.assert_close(extent, 1.05 * torch.tensor([1.0, 0.5, 1.0]))

    def test_holds_every_frame_of_a_pan(self):
        start = torch.eye(3, 4).repeat(3, 1, 1)
        start[:, 0, 3] = torch.tensor([-1.0, 0.0, 2.0])
        torch.testing.assert_close(canonical_extent(start, self.plane), 1.05 * torch.tensor([3.0, 0.5, 1.0]))

    def test_holds_a_turned_frame(self):
        start = torch.eye(3, 4)[None].clone()
        start[0, :2, :2] = torch.tensor([[0.0, -1.0], [1.0, 0.0]])
        torch.testing.assert_close(canonical_extent(start, self.plane), 1.05 * torch.tensor([0.5, 1.0, 1.0]))

    def test_ends(self):
        start = torch.eye(3, 4)[None].clone()
        start[0, 0, 3] = 100.0
        assert canonical_extent(start, self.plane)[0] == MAX_EXTENT


def test_pair_conditioning_of_one_frame_is_its_row_of_all_frames():
    model = randomised(tiny_model("cpu"), 0.05)
    everything = model.condition(torch.arange(FRAMES))
    one = model.condition(torch.tensor([2]))
    assert isinstance(one, PairConditioning)
    for alone, among in zip(one, everything, strict=True):
        torch.testing.assert_close(alone.affine[0], among.affine[2])


def test_the_motion_mask_is_of_the_fusion_or_as_printed_of_the_static_volume_alone():
    """Where an opaque object stands before the scene, the scene's own mask still says static; the fusion's does not."""
    model = randomised(tiny_model("cpu", feature_size=0), 0.05)
    frame = torch.tensor([0, 3])
    found = {}
    for kind in ("fused", "static"):
        model.config = model.config.model_copy(update={"motion_mask": kind})
        found[kind] = model.predict(random_units(2, 6), frame, frame, offsets(model, random_units(2, 6)))
    xy = random_pixels(2, 6)
    rays = model.cast(xy, model.condition(frame), offset=offsets(model, xy))
    through = torch.ones(2, 6)
    printed, fused_static, fused_all, through_both = torch.zeros(2, 6), torch.zeros(2, 6), torch.zeros(2, 6), through
    for sample in range(rays.depths.shape[-1]):  # Eq. 2 and 5, sample by sample
        beta = rays.static.confidence[..., sample]
        of_static, of_dynamic = rays.static.density[..., sample], rays.dynamic.density[..., sample]
        printed = printed + through * (1 - torch.exp(-of_static)) * beta
        through = through * torch.exp(-of_static)
        part = through_both * beta * (1 - torch.exp(-of_static))
        fused_static = fused_static + part
        fused_all = fused_all + part + through_both * (1 - beta) * (1 - torch.exp(-of_dynamic))
        through_both = through_both * torch.exp(-beta * of_static - (1 - beta) * of_dynamic)
    torch.testing.assert_close(found["static"].motion_mask, printed, rtol=0, atol=1e-5)
    torch.testing.assert_close(found["fused"].motion_mask, fused_static / fused_all, rtol=0, atol=1e-5)
    assert (found["static"].motion_mask - found["fused"].motion_mask).abs().max() > 0.01

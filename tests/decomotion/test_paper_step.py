"""Losses and gradients of an optimisation step of `paper`: as the plain computation in float64 gives them."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import fields

import pytest
import torch
from torch import Tensor

import plain_step
from decomotion.config import load
from decomotion.data.batch import Batch
from decomotion.geometry import ImagePlane
from decomotion.losses import LOSSES
from decomotion.model.fusion import DecoMotion, Prediction
from decomotion.model.precision import HiddenLinear, set_precision
from decomotion.rays import sample_depths
from tiny_fit import randomised, tiny_model

FRAMES, PAIRS, POINTS, SMOOTH, FEATURE = 6, 4, 12, 5, 3
CONDITIONER = "{kind: mlp, frequencies: 4, encoding: 32, hidden: 32, layers: 3}"
FIELD = "{kind: gabor, width: 64, layers: 3, input_scale: 16.0, alpha: 3.0}"
WIDER = (
    *(f"model.{volume}.conditioner={CONDITIONER}" for volume in ("static", "dynamic")),
    *(f"model.{field}={FIELD}" for field in ("static.field", "dynamic.field", "feature_field")),
)
Result = tuple[dict[str, float], dict[str, Tensor]]
"""Losses, and gradients by parameter."""


@pytest.fixture(autouse=True)
def double() -> Iterator[None]:
    """Constants that the plain computation writes down are float64."""
    former = torch.get_default_dtype()
    torch.set_default_dtype(torch.float64)
    yield
    torch.set_default_dtype(former)


@pytest.fixture(params=["cpu", pytest.param("cuda", marks=pytest.mark.gpu)])
def device(request: pytest.FixtureRequest) -> str:
    """Where the step is computed; the plain computation is on the same."""
    return request.param


def drifting() -> Tensor:
    """Affine maps of frames that drift in depth, so that samples leave the volume's range."""
    start = torch.eye(3, 4, dtype=torch.float32).repeat(FRAMES, 1, 1)
    start[:, 2, 3] = 0.1 * torch.arange(FRAMES)
    return start


@pytest.fixture
def model(device: str) -> DecoMotion:
    """Small networks far from a start: with noise in all weights every part of the computation counts."""
    torch.set_default_dtype(torch.float32)
    made = tiny_model("paper", frames=FRAMES, feature_size=FEATURE, start=drifting(), overrides=WIDER)
    torch.set_default_dtype(torch.float64)
    return randomised(made.double(), 0.03).to(device)


@pytest.fixture
def full_model(device: str) -> DecoMotion:
    """The preset's own sizes, a little away from their start."""
    torch.set_default_dtype(torch.float32)
    torch.manual_seed(0)
    made = DecoMotion(load("paper").model, ImagePlane(24, 32), (drifting(), drifting()), FEATURE)
    torch.set_default_dtype(torch.float64)
    return randomised(made.double(), 0.003).to(device)


@pytest.fixture
def batch(device: str) -> Batch:
    """Pairs from both ends of the clip and from inside it; about half of the points move, some links are unknown."""
    generator = torch.Generator().manual_seed(0)

    def uniform(*shape: int) -> Tensor:
        return torch.rand(PAIRS, POINTS, *shape, generator=generator)

    xy = uniform(2) * torch.tensor([255.0, 191.0])
    return Batch(
        frame=torch.tensor([0, 5, 2, 3]),
        target_frame=torch.tensor([3, 4, 0, 5]),
        point=torch.zeros(PAIRS, POINTS, dtype=torch.int64),
        xy=xy,
        target_xy=xy + 4 * uniform(2) - 2,
        confidence=(uniform() - 0.2).clamp_min(0),
        rgb=uniform(3),
        feature=torch.nn.functional.normalize(uniform(FEATURE) - 0.5, dim=-1),
        moving=(uniform() < 0.5).double(),
        masked=torch.ones(PAIRS, POINTS),
        expected_xy=xy + 6 * uniform(2) - 3,
        expected_weight=uniform(),
    ).to(torch.device(device))


def with_gradients(model: DecoMotion, prediction: Prediction, batch: Batch, without: str = "") -> Result:
    """Of the sum of all losses but one, each with a weight of its own."""
    losses = {name: loss(prediction, batch) for name, loss in LOSSES.items() if name != without}
    total = sum((1 + 0.1 * number) * loss for number, loss in enumerate(losses.values()))
    assert isinstance(total, Tensor)
    gradients = torch.autograd.grad(total, list(model.parameters()))
    names = [name for name, _ in model.named_parameters()]
    return {name: loss.item() for name, loss in losses.items()}, dict(zip(names, gradients, strict=True))


def predicted(model: DecoMotion, batch: Batch, depths: Tensor) -> Prediction:
    """The model's own computation at given depths."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("decomotion.model.fusion.sample_depths", lambda *_: depths.to(batch.xy.dtype))
        return model.predict(batch.xy, batch.frame, batch.target_frame, depths, SMOOTH)


def depths_of(model: DecoMotion, batch: Batch) -> Tensor:
    offset = torch.rand(PAIRS, POINTS, model.config.samples, generator=torch.Generator().manual_seed(1))
    return sample_depths(batch.xy, model.config.samples, offset.to(batch.xy))


def plain(model: DecoMotion, batch: Batch, depths: Tensor, without: str = "") -> Result:
    found = plain_step.predict(model, batch.xy, batch.frame, batch.target_frame, depths, SMOOTH)
    return with_gradients(model, found, batch, without)


def single(batch: Batch) -> Batch:
    values = {field.name: getattr(batch, field.name) for field in fields(Batch)}
    return Batch(**{name: value.float() if value.is_floating_point() else value for name, value in values.items()})


def lowered(model: DecoMotion, batch: Batch, depths: Tensor, autocast: str, without: str = "") -> Result:
    """The model's own computation in float32, its hidden layers as `autocast` says."""
    torch.set_default_dtype(torch.float32)
    lower, less = copy.deepcopy(model).float(), single(batch)
    set_precision(lower, autocast)  # type: ignore[arg-type]
    return with_gradients(lower, predicted(lower, less, depths), less, without)


def apart(found: dict[str, Tensor], expected: dict[str, Tensor]) -> float:
    """Norm of the difference of the whole gradient, as a share of the norm of `expected`."""
    difference = torch.cat([(found[name].double() - value).flatten() for name, value in expected.items()])
    return float(difference.norm() / torch.cat([value.flatten() for value in expected.values()]).norm())


def test_in_float64_it_is_the_plain_computation(model: DecoMotion, batch: Batch):
    depths = depths_of(model, batch)
    expected = plain(model, batch, depths)
    found = with_gradients(model, predicted(model, batch, depths), batch)
    assert found[0] == pytest.approx(expected[0], rel=1e-11)
    for name, gradient in expected[1].items():
        # of each parameter's largest entry
        torch.testing.assert_close(found[1][name], gradient, rtol=0, atol=1e-10 * float(gradient.abs().max()), msg=name)
        assert gradient.any(), name


def test_in_float32_it_is_near(model: DecoMotion, batch: Batch):
    depths = depths_of(model, batch)
    losses, gradients = plain(model, batch, depths)
    found = lowered(model, batch, depths, "none")
    assert found[0] == pytest.approx(losses, rel=1e-3)  # scene flow, a difference of near positions, is the farthest
    assert apart(found[1], gradients) < 1e-5


def test_in_mixed_precision_it_is_within_the_stated_tolerance(full_model: DecoMotion, batch: Batch):
    """Losses within 0.1 %, the gradient of each module within 2 % of its norm, with two exceptions.

    Coupling layers and frame codes, and with them the whole: 20 %. They reach the losses through a map and
    another one's inverse, whose gradients nearly cancel as long as frames are alike, as here, near the start.
    Scene-flow smoothness is a difference as well: the loss is within 1e-4 in normalised coordinates (0.013 units), and
    its slope is the sign of accelerations, which smaller ones lose. So it counts in the whole
    gradient but not in the modules'.
    """
    depths = depths_of(full_model, batch)
    losses, gradients = plain(full_model, batch, depths)
    found = lowered(full_model, batch, depths, "bf16")
    assert found[0].pop("scene_flow") == pytest.approx(losses.pop("scene_flow"), abs=1e-4)
    assert found[0] == pytest.approx(losses, rel=1e-3)
    assert 1e-3 < apart(found[1], gradients) < 0.2  # far above what float32 alone is off by

    torch.set_default_dtype(torch.float64)
    _, gradients = plain(full_model, batch, depths, without="scene_flow")
    _, found = lowered(full_model, batch, depths, "bf16", without="scene_flow")
    for module in {".".join(name.split(".")[:2]) for name in gradients}:
        its = {name: value for name, value in gradients.items() if name.startswith(module)}
        limit = 0.2 if module.startswith("frame_code") or module.endswith(".couplings") else 0.02
        assert apart(found, its) < limit, module


def test_precision_is_of_hidden_layers_and_can_be_taken_back(model: DecoMotion, batch: Batch):
    lower = copy.deepcopy(model).float()
    hidden = [module for module in lower.modules() if isinstance(module, HiddenLinear)]
    assert len(hidden) == 3 * 3 + 3 * 3  # of each coupling's MLP and of each field
    given = torch.ones(2, hidden[0].in_features, dtype=torch.float32, device=batch.xy.device)
    set_precision(lower, "bf16")
    assert hidden[0](given).dtype == torch.bfloat16
    assert all(parameter.dtype == torch.float32 for parameter in lower.parameters())
    set_precision(lower, "none")
    assert hidden[0](given).dtype == torch.float32

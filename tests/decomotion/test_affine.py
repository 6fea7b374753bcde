"""The camera's affine maps."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from decomotion.model.affine import AffineTransform, inverse_3x3
from tiny_fit import randomised

CODE, FRAMES = 4, 5


def random(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


@pytest.fixture
def start() -> Tensor:
    return torch.eye(3, 4).double() + 0.1 * random(FRAMES, 3, 4)


@pytest.fixture
def transform(start: Tensor) -> AffineTransform:
    return AffineTransform(CODE, 6, start).double()


@pytest.mark.parametrize("batch", [(), (4,), (2, 3)])
def test_inverse_is_torch_s(batch: tuple[int, ...]):
    matrix = random(*batch, 3, 3)
    torch.testing.assert_close(inverse_3x3(matrix), torch.linalg.inv(matrix))


def test_inverse_by_hand():
    matrix = torch.tensor([[2.0, 0.0, 0.0], [0.0, 0.0, 4.0], [0.0, 1.0, 0.0]])
    torch.testing.assert_close(inverse_3x3(matrix), torch.tensor([[0.5, 0, 0], [0, 0, 1], [0, 0.25, 0]]))


def test_before_training_it_is_the_start(transform: AffineTransform, start: Tensor):
    assert torch.equal(transform.condition(random(FRAMES, CODE))[..., :4], start)


def test_the_correction_is_divided_by_the_width_of_the_hidden_layer(transform: AffineTransform, start: Tensor):
    """Six channels that are each moved by a thousandth together move a map by no more than one of them."""
    with torch.no_grad():
        for parameter in transform.correction[0].parameters():
            parameter.fill_(0.0)
        transform.correction[0].bias.fill_(1.0)
        transform.correction[2].weight.fill_(1e-3)
    moved = transform.condition(random(FRAMES, CODE))[..., :4] - start
    torch.testing.assert_close(moved, torch.full_like(moved, 1e-3))


def test_to_canonical_is_a_x_plus_b(transform: AffineTransform, start: Tensor):
    points = random(FRAMES, 6, 3)
    mapped = transform.to_canonical(points, transform.condition(random(FRAMES, CODE)))
    for frame in range(FRAMES):
        for point in range(6):
            expected = start[frame, :, :3] @ points[frame, point] + start[frame, :, 3]
            torch.testing.assert_close(mapped[frame, point], expected)


def test_there_and_back(transform: AffineTransform):
    maps = randomised(transform, 0.1).condition(random(FRAMES, CODE))
    points = random(FRAMES, 6, 3, seed=1)
    torch.testing.assert_close(transform.from_canonical(transform.to_canonical(points, maps), maps), points)
    torch.testing.assert_close(transform.to_canonical(transform.from_canonical(points, maps), maps), points)


def test_the_correction_depends_on_the_frame_s_code(transform: AffineTransform, start: Tensor):
    correction = randomised(transform, 0.1).condition(random(FRAMES, CODE))[..., :4] - start
    assert (correction[0] - correction[1]).abs().max() > 1e-3


def test_the_start_is_saved_but_not_learned(transform: AffineTransform):
    assert "start" in transform.state_dict()
    assert "start" not in dict(transform.named_parameters())

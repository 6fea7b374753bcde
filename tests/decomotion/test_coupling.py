"""Coupling layers: exact inverses, what they leave alone, and slow twins of their conditioners."""

from __future__ import annotations

import math

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from decomotion.model.config import GridConditionerConfig, MlpConditionerConfig
from decomotion.model.coupling import (
    LOG_SCALE_LIMIT,
    CouplingLayer,
    GridConditioner,
    MlpConditioner,
    enlarged,
    grid_size,
    spacing,
)
from tiny_fit import randomised

Direction = tuple[float, float, float]

AXES: list[Direction] = [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]
OBLIQUE: list[Direction] = [(1.0, 0.0, 1.0), (0.0, 1.0, 1.0), (1.0, 0.0, -1.0), (0.0, 1.0, -1.0), (1.0, 2.0, -3.0)]
ALONG_DEPTH = AXES[2]
MLP = MlpConditionerConfig(kind="mlp", frequencies=2, encoding=8, hidden=8, layers=3)
GRID = GridConditionerConfig(kind="grid", cells=(3, 6), rank=3, slope=0.5)
CODE, FRAMES, ROWS, POINTS = 5, 4, 6, 9
EXTENT = torch.tensor([1.0, 0.6, 1.0])

both_conditioners = pytest.mark.parametrize("conditioner", [MLP, GRID], ids=["mlp", "grid"])
all_directions = pytest.mark.parametrize("direction", AXES + OBLIQUE, ids=str)


def random(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def make_layer(direction: Direction, conditioner: MlpConditionerConfig | GridConditionerConfig) -> CouplingLayer:
    """A layer in double precision whose parameters are all random."""
    torch.manual_seed(0)
    return randomised(CouplingLayer(direction, conditioner, CODE, EXTENT).double(), 0.3)


@both_conditioners
@all_directions
def test_there_and_back(direction: Direction, conditioner: MlpConditionerConfig | GridConditionerConfig):
    layer = make_layer(direction, conditioner)
    conditioning = layer.condition(random(FRAMES, CODE))
    points = random(FRAMES, POINTS, 3, seed=1)
    there = layer.to_canonical(points, conditioning)
    assert (there - points).norm(dim=-1).mean() > 0.05
    # the directions' bases are rounded to float32
    torch.testing.assert_close(layer.from_canonical(there, conditioning), points, rtol=0, atol=1e-6)
    back = layer.from_canonical(points, conditioning)
    torch.testing.assert_close(layer.to_canonical(back, conditioning), points, rtol=0, atol=1e-6)


@both_conditioners
@all_directions
def test_points_move_along_the_direction_alone(
    direction: Direction, conditioner: MlpConditionerConfig | GridConditionerConfig
):
    layer = make_layer(direction, conditioner)
    points = random(FRAMES, POINTS, 3, seed=1)
    moved = layer.to_canonical(points, layer.condition(random(FRAMES, CODE))) - points
    along = torch.tensor(direction, dtype=torch.float64).expand_as(moved)
    # as above
    torch.testing.assert_close(torch.linalg.cross(moved, along), torch.zeros_like(moved), rtol=0, atol=1e-5)


@both_conditioners
@pytest.mark.parametrize("direction", [ALONG_DEPTH, OBLIQUE[0]], ids=str)
def test_a_frame_for_each_row_is_a_conditioning_for_each_row(
    direction: Direction, conditioner: MlpConditionerConfig | GridConditionerConfig
):
    layer = make_layer(direction, conditioner)
    conditioning = layer.condition(random(FRAMES, CODE))
    frame = torch.tensor([2, 0, 3, 3, 1, 0])
    points = 1.5 * random(ROWS, POINTS, 3, seed=1)  # some beyond the grids' extent
    torch.testing.assert_close(
        layer.to_canonical(points, conditioning, frame), layer.to_canonical(points, conditioning[frame])
    )
    torch.testing.assert_close(
        layer.from_canonical(points, conditioning, frame), layer.from_canonical(points, conditioning[frame])
    )


def test_the_stack_of_a_hundred_frames_grids_does_not_mix_them():
    layer = randomised(CouplingLayer(ALONG_DEPTH, GRID, CODE, EXTENT), 0.3)
    conditioning = layer.condition(random(100, CODE).float())
    edges = torch.tensor([[-2.0, -2.0, 0.0], [2.0, 2.0, 0.0], [0.0, 0.6, 0.0], [0.0, -0.6, 0.0]]).expand(100, 4, 3)
    each = layer.to_canonical(edges, conditioning, torch.arange(100))
    # float32 positions in a stack of 100 grids: 2e-5 of a cell, at the outermost of which the next frame's begins
    torch.testing.assert_close(each, layer.to_canonical(edges, conditioning), rtol=0, atol=1e-4)


def test_the_equation():
    layer = make_layer(ALONG_DEPTH, MLP)
    conditioning = layer.condition(random(1, CODE))
    points = random(1, POINTS, 3, seed=1)
    log_scale, shift = layer.conditioner(points[..., :2], conditioning, None)
    expected = points[..., 2] * log_scale.exp() + shift
    torch.testing.assert_close(layer.to_canonical(points, conditioning)[..., 2], expected)


@both_conditioners
def test_both_conditioners_tell_frames_and_places_apart(conditioner: MlpConditionerConfig | GridConditionerConfig):
    layer = make_layer(ALONG_DEPTH, conditioner)
    points = random(1, 2, 3, seed=1).expand(FRAMES, 2, 3)
    moved = layer.to_canonical(points, layer.condition(random(FRAMES, CODE))) - points
    assert (moved[0] - moved[1]).abs().max() > 1e-3
    assert (moved[:, 0] - moved[:, 1]).abs().max() > 1e-3


@all_directions
def test_grids_start_as_the_identity(direction: Direction):
    layer = CouplingLayer(direction, GRID, CODE, EXTENT)
    points = random(FRAMES, POINTS, 3).float()
    assert torch.equal(layer.to_canonical(points, layer.condition(random(FRAMES, CODE).float())), points)


def test_mlps_start_near_the_identity():
    torch.manual_seed(0)
    layer = CouplingLayer(OBLIQUE[0], MLP, CODE, EXTENT)
    points = random(FRAMES, POINTS, 3).float()
    moved = layer.to_canonical(points, layer.condition(random(FRAMES, CODE).float())) - points
    assert moved.abs().max() < 0.02


@all_directions
def test_basis_is_orthonormal(direction: Direction):
    basis = CouplingLayer(direction, GRID, CODE, EXTENT).basis
    torch.testing.assert_close(basis @ basis.T, torch.eye(3))
    torch.testing.assert_close(basis[2], F.normalize(torch.tensor(direction, dtype=torch.float32), dim=0))


@pytest.mark.parametrize("direction", OBLIQUE, ids=str)
def test_an_oblique_layer_sees_a_surface_through_a_one_to_one_projection(direction: Direction):
    """The surface's (x, y) and the layer's plane determine each other: each point can move by an amount of its own."""
    basis = CouplingLayer(direction, GRID, CODE, EXTENT).basis
    assert torch.linalg.det(basis[:2, :2]).abs() > 0.5


def test_mlp_against_the_network_before_its_first_layer_was_split():
    torch.manual_seed(0)
    split = randomised(MlpConditioner(MLP, CODE).double(), 0.3)
    code, plane = random(FRAMES, CODE), random(FRAMES, POINTS, 2, seed=1)
    first = torch.nn.Linear(MLP.encoding + CODE, MLP.hidden).double()
    with torch.no_grad():
        first.weight.copy_(torch.cat([split.from_plane.weight, split.from_code.weight], dim=1))
        first.bias.copy_(split.from_code.bias)
    log_scale, shift = split(plane, split.condition(code), None)
    for frame in range(FRAMES):
        for point in range(POINTS):
            a, b = plane[frame, point]
            waves = [f(2**octave * torch.pi * c) for f in (torch.sin, torch.cos) for c in (a, b) for octave in range(2)]
            encoded = F.leaky_relu(split.encode(torch.stack([a, b, *waves])))
            hidden = F.leaky_relu(first(torch.cat([encoded, split.project_code(code[frame])])))
            for layer in split.hidden:
                hidden = F.leaky_relu(layer(hidden))
            expected = split.output(hidden)
            # the frequencies are rounded to float32
            assert log_scale[frame, point].item() == pytest.approx(expected[0].item(), abs=1e-5)
            assert shift[frame, point].item() == pytest.approx(expected[1].item(), abs=1e-5)


def test_log_scales_of_networks_are_limited():
    layer = randomised(CouplingLayer(ALONG_DEPTH, MLP, CODE, EXTENT), 1000.0)
    log_scale, _ = layer.conditioner(
        random(FRAMES, POINTS, 2).float(), layer.condition(random(FRAMES, CODE).float()), None
    )
    assert log_scale.abs().max() == LOG_SCALE_LIMIT


def test_no_level_of_a_grid_is_steeper_than_asked():
    config = GridConditionerConfig(kind="grid", cells=(6,), rank=3, slope=0.5)
    conditioner = randomised(GridConditioner(config, CODE, EXTENT[:2]), 1000.0)
    grids = conditioner.condition(random(FRAMES, CODE).float())
    height, width = grids.shape[-2:]
    half_x, half_y = EXTENT[:2].tolist()
    across = grids.diff(dim=-1).abs().max() / (2 * half_x / (width - 1))
    down = grids.diff(dim=-2).abs().max() / (2 * half_y / (height - 1))
    assert max(across, down).item() == pytest.approx(0.5)  # reached by weights as wild as these, not passed


def test_frames_grids_are_mixtures():
    conditioner = randomised(
        GridConditioner(GridConditionerConfig(kind="grid", cells=(4,), rank=3, slope=0.5), CODE, EXTENT[:2])
    )
    code = random(FRAMES, CODE).float()
    grids = conditioner.condition(code)
    mixing, basis = conditioner.mixing[0], conditioner.basis[0]
    assert isinstance(mixing, torch.nn.Linear)
    for frame in range(FRAMES):
        mixture = sum((mixing.weight[r] @ code[frame]) * basis[r] for r in range(3))
        bound = conditioner.bounds[0]
        torch.testing.assert_close(grids[frame], bound * torch.tanh(mixture / bound))


def test_grids_are_read_bilinearly_and_constant_beyond():
    conditioner = GridConditioner(
        GridConditionerConfig(kind="grid", cells=(2,), rank=1, slope=0.5), 1, torch.tensor([1.0, 0.5])
    )
    shift = torch.tensor([[1.0, 2.0, 3.0], [5.0, 7.0, 9.0]])  # rows at y = -0.5 and 0.5, columns at x = -1, 0 and 1
    grid = torch.stack([torch.zeros(2, 3), shift])[None]
    where = torch.tensor([[-1.0, -0.5], [0.0, 0.5], [0.5, -0.5], [0.5, 0.0], [4.0, 4.0], [-9.0, 0.0]])
    for frame in (None, torch.tensor([0])):
        _, read = conditioner(where[None], grid, frame)
        torch.testing.assert_close(read[0], torch.tensor([1.0, 7.0, 2.5, 5.25, 9.0, 3.0]))


@pytest.mark.parametrize(
    ("half", "cells", "height_width"),
    [((1.0, 1.0), 2, (3, 3)), ((1.0, 0.5625), 16, (10, 17)), ((2.0, 0.25), 4, (2, 9)), ((0.3, 1.0), 2, (3, 2))],
)
def test_grid_size(half: tuple[float, float], cells: int, height_width: tuple[int, int]):
    assert grid_size(torch.tensor(half), cells) == height_width


@pytest.mark.parametrize("size", [(4, 3), (7, 11), (10, 3)])
def test_levels_are_enlarged_bilinearly_corners_on_corners(size: tuple[int, int]):
    grids = torch.rand(5, 2, 4, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    expected = F.interpolate(grids, size=size, mode="bilinear", align_corners=True)
    torch.testing.assert_close(enlarged(grids, size), expected)


@pytest.mark.parametrize("layers", [1, 2, 4])
def test_an_mlp_has_the_layers_it_was_asked_for(layers: int):
    """Of the configured width, each with its weights; then the output's."""
    config = MlpConditionerConfig(kind="mlp", frequencies=2, encoding=5, hidden=7, layers=layers)
    conditioner = MlpConditioner(config, code_size=6)
    squares = [p for p in conditioner.parameters() if p.shape == (7, 7)]
    assert len(squares) == layers - 1  # the first is from the encoding and the code
    assert conditioner.encode.in_features == 2 + 2 * 2 * 2  # x and y, sine and cosine, two frequencies
    torch.testing.assert_close(conditioner.frequencies, torch.tensor([math.pi, 2 * math.pi]))


def test_cells_are_counted_along_the_longer_side():
    half = torch.tensor([1.0, 0.55])
    assert grid_size(half, 8) == (6, 9)
    assert grid_size(half.flip(0), 8) == (9, 6)
    assert spacing(half, torch.zeros(2, 5, 9)) == pytest.approx(0.25)  # 2 / 8 across, 1.1 / 4 down
    assert spacing(half, torch.zeros(2, 12, 9)) == pytest.approx(0.1)  # 1.1 / 11


@both_conditioners
def test_checkpoints_hold_what_is_learned_and_nothing_else(conditioner: MlpConditionerConfig | GridConditionerConfig):
    layer = make_layer(OBLIQUE[0], conditioner)
    assert set(layer.state_dict()) == {name for name, _ in layer.named_parameters()}

"""Frame codes."""

from __future__ import annotations

import pytest
import torch

from decomotion.model import frame_code
from decomotion.model.config import TableCodeConfig, TimeCodeConfig
from decomotion.model.frame_code import build_frame_code

TIME = TimeCodeConfig(kind="time", size=6, hidden=16, frequencies=3)
TABLE = TableCodeConfig(kind="table", size=6, frequencies=3)

both_kinds = pytest.mark.parametrize("config", [TIME, TABLE], ids=["time", "table"])


@both_kinds
@pytest.mark.parametrize("frames", [2, 3, 50])
def test_one_code_a_frame(config: TimeCodeConfig | TableCodeConfig, frames: int):
    assert build_frame_code(config, frames)().shape == (frames, 6)


@both_kinds
def test_codes_begin_smooth_in_time_and_all_different(config: TimeCodeConfig | TableCodeConfig):
    torch.manual_seed(0)
    codes = build_frame_code(config, 50)()
    distance = torch.cdist(codes, codes)
    neighbours = distance.diagonal(1)
    assert neighbours.min() > 0
    assert neighbours.max() < 0.5 * distance.max()


@both_kinds
def test_the_seed_decides(config: TimeCodeConfig | TableCodeConfig):
    codes = []
    for seed in (1, 1, 2):
        torch.manual_seed(seed)
        codes.append(build_frame_code(config, 5)())
    assert torch.equal(codes[0], codes[1])
    assert not torch.equal(codes[0], codes[2])


def test_time_runs_from_minus_one_to_one_beside_waves_of_growing_frequency():
    """Quarter a turn to either side at first, twice as much each time: sines, then cosines."""
    half = 0.5**0.5
    encoded = frame_code._encode_time(5, 2)
    expected = [
        [-1.0, -1.0, 0.0, 0.0, -1.0],
        [-0.5, -half, -1.0, half, 0.0],
        [0.0, 0.0, 0.0, 1.0, 1.0],
        [0.5, half, 1.0, half, 0.0],
        [1.0, 1.0, 0.0, 0.0, -1.0],
    ]
    torch.testing.assert_close(encoded, torch.tensor(expected), atol=1e-6, rtol=0)


@pytest.mark.parametrize("frequencies", [2, 5])
def test_learned_codes_begin_of_about_unit_size(frequencies: int):
    torch.manual_seed(0)
    codes = build_frame_code(TableCodeConfig(kind="table", size=4000, frequencies=frequencies), 7)()
    time = torch.linspace(-1, 1, 7)
    # of each frequency a sine and a cosine, whose squares sum to 1, and time itself: over half of how many there are
    expected = (frequencies + time**2) / (frequencies + 0.5)
    torch.testing.assert_close(codes.square().mean(1), expected, atol=0, rtol=0.1)

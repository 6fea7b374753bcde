"""Frame codes."""

from __future__ import annotations

import pytest
import torch

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

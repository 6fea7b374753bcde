"""Latent codes: what tells the networks which frame they are in (paper, phi_i)."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor, nn

from decomotion.model.config import TableCodeConfig, TimeCodeConfig


def build_frame_code(config: TimeCodeConfig | TableCodeConfig, num_frames: int) -> nn.Module:
    """The module that `config` describes; calling it gives the codes of all frames, [frame, code]."""
    return TimeCode(config, num_frames) if config.kind == "time" else TableCode(config, num_frames)


def _encode_time(num_frames: int, frequencies: int) -> Float[Tensor, "frame encoding"]:
    time = torch.linspace(-1, 1, num_frames)[:, None]
    angles = time * math.pi / 2 * 2.0 ** torch.arange(frequencies)
    return torch.cat([time, torch.sin(angles), torch.cos(angles)], dim=-1)


class TimeCode(nn.Module):
    """Normalised time, positionally encoded, through a 2-layer network: codes that change smoothly."""

    time: Tensor

    def __init__(self, config: TimeCodeConfig, num_frames: int) -> None:
        super().__init__()
        self.register_buffer("time", _encode_time(num_frames, config.frequencies), persistent=False)
        self.network = nn.Sequential(
            nn.Linear(1 + 2 * config.frequencies, config.hidden),
            nn.ReLU(),
            nn.Linear(config.hidden, config.hidden),
            nn.ReLU(),
            nn.Linear(config.hidden, config.size),
        )

    def forward(self) -> Float[Tensor, "frame code"]:
        """The codes of all frames."""
        return self.network(self.time)


class TableCode(nn.Module):
    """One freely learned code per frame; it starts as random smooth functions of time."""

    def __init__(self, config: TableCodeConfig, num_frames: int) -> None:
        super().__init__()
        encoding = _encode_time(num_frames, config.frequencies)
        smooth = encoding @ torch.randn(encoding.shape[-1], config.size) / math.sqrt(encoding.shape[-1] / 2)
        self.codes = nn.Parameter(smooth)

    def forward(self) -> Float[Tensor, "frame code"]:
        """The codes of all frames."""
        return self.codes

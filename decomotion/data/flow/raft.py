"""RAFT (Teed and Deng 2020) in torchvision's form: its weights, or the original Princeton checkpoints."""

from __future__ import annotations

import re

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from decomotion.data.flow.config import RaftFlowConfig
from decomotion.data.flow.interface import Flow, Frame, enlarged, kept, resized, to_raster
from decomotion.data.weights import downloaded, read_state
from decomotion.errors import SupervisionError
from decomotion.extras import remedy

MULTIPLE = 8
"""RAFT's features are at an eighth of the resolution."""
MIN_SIDE = 128
"""Its correlation pyramid has four levels, which smaller frames cannot fill."""

PRINCETON_TO_TORCHVISION = (
    (r"^fnet\.", "feature_encoder."),
    (r"^cnet\.", "context_encoder."),
    (r"_encoder\.conv1\.", "_encoder.convnormrelu.0."),
    (r"_encoder\.norm1\.", "_encoder.convnormrelu.1."),
    (r"_encoder\.conv2\.", "_encoder.conv."),
    (r"(layer\d\.\d)\.conv(\d)\.", r"\1.convnormrelu\2.0."),
    (r"(layer\d\.\d)\.norm(\d)\.", r"\1.convnormrelu\2.1."),
    (r"^update_block\.encoder\.conv\.", "update_block.motion_encoder.conv.0."),
    (r"^update_block\.encoder\.convc(\d)\.", r"update_block.motion_encoder.convcorr\1.0."),
    (r"^update_block\.encoder\.convf(\d)\.", r"update_block.motion_encoder.convflow\1.0."),
    (r"^update_block\.gru\.conv([zrq])\.", r"update_block.recurrent_block.convgru1.conv\1."),
    (r"^update_block\.gru\.conv([zrq])(\d)\.", r"update_block.recurrent_block.convgru\2.conv\1."),
    (r"^update_block\.mask\.0\.", "mask_predictor.convrelu.0."),
    (r"^update_block\.mask\.2\.", "mask_predictor.conv."),
)
"""Names of the original code, applied in this order to keys without `module.`."""


class RaftFlow:
    """RAFT on frames enlarged as configured, at least `MIN_SIDE` pixels a side; see `FlowEstimator`."""

    guided = False
    concurrent = False

    def __init__(self, config: RaftFlowConfig, device: str = "cpu") -> None:
        self._config, self.field_side = config, config.field_side
        self._device = torch.device(device)
        self._model = load_raft(config.kind, config.weights).to(self._device)

    def __call__(
        self,
        first: Frame,
        second: Frame,
        pair: tuple[int, int] = (0, 1),  # noqa: ARG002
        start: Flow | None = None,  # noqa: ARG002
    ) -> Flow:
        """See `FlowEstimator`; the field's raster is that of the frames, limited to `field_side`."""
        height, width = first.shape[:2]
        size = enlarged(height, width, self._config.upsample, self._config.max_side, MIN_SIDE)
        margins = _margins(size[0]) + _margins(size[1])
        images = (self._prepared(frame, size, margins) for frame in (first, second))
        with torch.inference_mode():
            flow = self._model(*images, num_flow_updates=self._config.iterations)[-1]
        left, _, top, _ = margins
        inside = flow[0, :, top : top + size[1], left : left + size[0]].permute(1, 2, 0)
        flow = np.ascontiguousarray(inside.float().cpu().numpy())
        return to_raster(flow, kept(height, width, self._config.field_side))

    def effort(self, gap: int) -> float:  # noqa: ARG002
        """The same at any gap."""
        return 1.0

    def require(self, pairs: list[tuple[int, int]]) -> None:
        """It answers any pair."""

    def _prepared(self, frame: Frame, size: tuple[int, int], margins: tuple[int, ...]) -> Tensor:
        """[1, 3, h, w] in [-1, 1], the border repeated to sides that are multiples of 8."""
        image = torch.from_numpy(resized(frame, size)).to(self._device).permute(2, 0, 1)[None].float() / 127.5 - 1
        return F.pad(image, margins, mode="replicate")


def _margins(side: int) -> tuple[int, int]:
    missing = -side % MULTIPLE
    return missing // 2, missing - missing // 2


def load_raft(kind: str, weights: str | None) -> nn.Module:
    """`raft-small` or `raft-large` with torchvision's default weights, or with those of a file.

    Raises `SupervisionError` where torchvision is not installed, the file does not fit, or the download fails.
    """
    try:
        from torchvision.models import optical_flow
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] != "torchvision":
            raise
        raise SupervisionError(
            f"flow {kind} needs torchvision, which is not installed; run: {remedy('torchvision')}, or take --flow dis"
        ) from error

    build = {"raft-small": optical_flow.raft_small, "raft-large": optical_flow.raft_large}[kind]
    if weights is None:
        return downloaded(
            lambda: build(weights="DEFAULT", progress=False),
            kind,
            "give a file with --flow-weights, or take --flow dis, which needs none",
        ).eval()
    model = build(weights=None)
    state = read_state(weights, "--flow-weights")
    if any(key.startswith("fnet.") for key in state):
        state = from_princeton(state)
    try:
        model.load_state_dict(state)
    except RuntimeError as error:
        raise SupervisionError(
            f"--flow-weights {weights} does not hold {kind}'s weights in torchvision's or the original code's form; "
            "give another file, or another --flow"
        ) from error
    return model.eval()


def from_princeton(state: dict[str, Tensor]) -> dict[str, Tensor]:
    """A state dict of the original code under torchvision's names."""
    # the original registers a residual block's third norm a second time, in its `downsample`
    twice = {key for key in state if re.search(r"layer\d\.\d\.norm3\.", key) and "cnet" in key}
    renamed = {}
    for key, value in state.items():
        if key in twice and key.replace("norm3", "downsample.1") in state:
            continue
        for pattern, replacement in PRINCETON_TO_TORCHVISION:
            key = re.sub(pattern, replacement, key)
        renamed[key] = value
    return renamed

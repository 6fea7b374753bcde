"""ALIKED (Zhao et al. 2023) in kornia's form: its dense map, before keypoints are chosen."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import torch
from kornia.feature import ALIKED

from decomotion.data.features.interface import FEATURE_SIDE, FeatureMap, resized
from decomotion.data.weights import downloaded, fitting, read_state
from decomotion.errors import SupervisionError

DOWNLOADED = "aliked-n16"
MODELS = ("aliked-n16", "aliked-t16", "aliked-n32")
"""Sizes that a file may have; the rotated n16 has n16's."""
OWN_BUFFERS = "dkd."
"""kornia's own, which files lack."""


class AlikedFeatures:
    """See `FeatureExtractor`; any of ALIKED's sizes, as the file of weights has it."""

    def __init__(self, weights: str | None = None, device: str = "cpu") -> None:
        self._device = torch.device(device)
        model = _from_file(weights) if weights is not None else _from_publisher()
        self._model = model.to(self._device).eval()
        self.channels: int = 4 * model.conv4.out_channels

    def __call__(self, frame: npt.NDArray[np.uint8]) -> FeatureMap:
        """Descriptors at every pixel of a frame, which is reduced to `FEATURE_SIDE` first."""
        image = torch.from_numpy(resized(frame, FEATURE_SIDE)).to(self._device).permute(2, 0, 1)[None].float() / 255
        with torch.inference_mode():
            described, _ = self._model.extract_dense_map(image)
        return described[0].permute(1, 2, 0).float().cpu().numpy()


def _from_publisher() -> ALIKED:
    return downloaded(
        lambda: ALIKED.from_pretrained(DOWNLOADED),
        "ALIKED",
        "give a file with --feature-weights, or take --features densesift, which needs none",
    )


def _from_file(weights: str) -> ALIKED:
    state = read_state(weights, "--feature-weights")
    for name in MODELS:
        model = ALIKED(name)
        if fitting(model, state, (OWN_BUFFERS,)):
            return model
    raise SupervisionError(
        f"--feature-weights {weights} does not hold ALIKED of a size that kornia knows ({', '.join(MODELS)}); "
        "give another file"
    )

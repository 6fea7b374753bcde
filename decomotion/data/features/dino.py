"""DINO (Caron et al. 2021): the patch tokens of a vision transformer, in timm's form. Needs timm."""

from __future__ import annotations

import re
from contextlib import suppress
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import numpy as np
import numpy.typing as npt
import timm
import torch
import torch.nn.functional as F
from huggingface_hub import try_to_load_from_cache
from huggingface_hub.constants import ENDPOINT
from torch import Tensor, nn

from decomotion.data.features.interface import FeatureMap, resized
from decomotion.data.weights import downloaded, read_state
from decomotion.errors import SupervisionError

DOWNLOADED = "vit_base_patch8_224.dino"
"""timm's name of the weights that are downloaded: ViT-B, 768 channels."""
SIZES = {384: "small", 768: "base"}
"""timm's names of the transformers by their channels."""
DINO_SIDE = 512
"""Frames are reduced to this longer side at most: 64 patches of 8 pixels."""
HUB_FILE = "model.safetensors"
"""Under which timm's repositories hold their weights."""
REACH_SECONDS = 10.0
MEAN, STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
"""Of ImageNet's colours, on which DINO was trained."""


class DinoFeatures:
    """See `FeatureExtractor`; ViT-S or ViT-B with patches of any size, as the file of weights has it."""

    def __init__(self, weights: str | None = None, device: str = "cpu") -> None:
        self._device = torch.device(device)
        self._model = (_from_file(weights) if weights is not None else _from_publisher()).to(self._device).eval()
        self.channels: int = self._model.embed_dim  # type: ignore[assignment]
        self._patch: int = self._model.patch_embed.patch_size[0]  # type: ignore[index,union-attr,assignment]

    def __call__(self, frame: npt.NDArray[np.uint8]) -> FeatureMap:
        """One descriptor for each patch of a frame, which is reduced to `DINO_SIDE` first."""
        image = torch.from_numpy(resized(frame, DINO_SIDE, self._patch)).to(self._device).float() / 255
        image = (image - image.new_tensor(MEAN)) / image.new_tensor(STD)
        rows, columns = (side // self._patch for side in image.shape[:2])
        with torch.inference_mode():
            tokens = self._model.forward_features(image.permute(2, 0, 1)[None])  # type: ignore[operator]
            patches = F.normalize(tokens[0, -rows * columns :], dim=-1)
        return patches.reshape(rows, columns, -1).float().cpu().numpy()


def _from_publisher() -> nn.Module:
    def load() -> nn.Module:
        _check_reachable()
        return timm.create_model(DOWNLOADED, pretrained=True, num_classes=0, dynamic_img_size=True)

    return downloaded(
        load, "DINO", "give a file with --feature-weights, or take --features densesift, which needs none"
    )


def _check_reachable() -> None:
    """Raises `OSError` at once where the weights are neither at hand nor reachable: the hub's retries take minutes."""
    if isinstance(try_to_load_from_cache(f"timm/{DOWNLOADED}", HUB_FILE), str):
        return
    with suppress(HTTPError):  # an answer, if only that
        urlopen(Request(ENDPOINT, method="HEAD"), timeout=REACH_SECONDS).close()


def _from_file(weights: str) -> nn.Module:
    state = read_state(weights, "--feature-weights")
    state = {re.sub(r"^backbone\.", "", key): value for key, value in state.items() if not key.startswith("head.")}
    embedding = state.get("patch_embed.proj.weight")
    size = SIZES.get(len(embedding)) if isinstance(embedding, Tensor) and embedding.ndim == 4 else None
    if size is None or embedding is None:
        raise SupervisionError(f"--feature-weights {weights} does not hold DINO's ViT-S or ViT-B; give another file")
    model = timm.create_model(
        f"vit_{size}_patch16_224",
        patch_size=embedding.shape[-1],
        num_classes=0,
        dynamic_img_size=True,
    )
    try:
        model.load_state_dict(state)
    except RuntimeError as error:
        raise SupervisionError(
            f"--feature-weights {weights} does not fit DINO's ViT-{size[0].upper()}; give another file"
        ) from error
    return model

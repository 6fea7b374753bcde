"""Weights of the networks that supervise: from their publishers on first use, or from the user's file.

A file is read with `weights_only=True`, so that nothing in it can run.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar
from urllib.error import URLError

import torch
from safetensors.torch import load_file
from torch import Tensor, nn

from decomotion.errors import DownloadError, SupervisionError

Module = TypeVar("Module")


def read_state(path: str | Path, option: str) -> dict[str, Tensor]:
    """The state dict in a file, a `module.` prefix and an enclosing `state_dict` or `model` entry removed.

    Raises `SupervisionError` naming `option` where there is no such file or it holds something else.
    """
    path = Path(path)
    if not path.is_file():
        raise SupervisionError(f"{option} {path} does not exist; give a file of weights")
    try:
        if path.suffix == ".safetensors":
            content: Any = load_file(path)
        else:
            content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # the readers raise what damaged content brings them to
        raise SupervisionError(f"{option} {path} is not a file of weights, or is damaged; give another") from error
    for key in ("state_dict", "model"):
        if isinstance(content, dict) and isinstance(content.get(key), dict):
            content = content[key]
    if not isinstance(content, dict) or not content or not all(isinstance(each, Tensor) for each in content.values()):
        raise SupervisionError(f"{option} {path} holds no state dict; give a file of weights")
    return {str(key).removeprefix("module."): value for key, value in content.items()}


def downloaded(load: Callable[[], Module], what: str, instead: str) -> Module:
    """What `load` returns; where its download fails, a `DownloadError` that says what to do `instead`."""
    try:
        return load()
    except (OSError, URLError, RuntimeError) as error:  # no network, or a file that does not fit its hash
        raise DownloadError(f"the weights of {what} cannot be downloaded on this machine; {instead}") from error


def fitting(module: nn.Module, state: dict[str, Tensor], optional: tuple[str, ...] = ()) -> bool:
    """Whether a state dict has all of the module's weights, and then loads them; what else it has is left out.

    Names that begin with one of `optional` need not be there.
    """
    wanted = {key: value.shape for key, value in module.state_dict().items() if not key.startswith(optional)}
    fits = all(key in state and state[key].shape == shape for key, shape in wanted.items())
    if fits:
        module.load_state_dict({key: state[key] for key in wanted}, strict=False)
    return fits

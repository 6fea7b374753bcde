"""The device that networks and fits run on."""

from __future__ import annotations

import torch

from decomotion.errors import ConfigError


def choose_device(name: str) -> str:
    """The device that `name` means; `auto` is CUDA where there is one.

    Raises `ConfigError` where torch does not know it, or cannot compute on it here.
    """
    if name == "auto":
        return "cuda" if torch.cuda.is_available() else "cpu"
    try:
        torch.device(name)
    except RuntimeError as error:
        raise ConfigError(f"--device {name} is not a device that torch knows; use auto, cpu or cuda") from error
    if name.startswith("cuda") and not torch.cuda.is_available():
        raise ConfigError("--device cuda was asked for but torch sees no CUDA device; use --device cpu or auto")
    try:
        usable = torch.empty(0, device=name).device.type != "meta"
    except (AssertionError, RuntimeError):
        usable = False
    if not usable:
        raise ConfigError(f"--device {name} cannot be computed on here; use auto, cpu or cuda")
    return name

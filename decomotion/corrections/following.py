"""What a finished model says: tracks of points, and the colour and owner of what is seen."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import torch

from decomotion.model.fusion import DecoMotion, PairConditioning
from decomotion.model.readout import OBJECT_SHARE, Surface, answer, carry, static_owns, surface_on

AT_ONCE = 2**14
"""Points times frames that are asked at a time."""
HIDDEN = 0.5
"""Occlusion score above which a point counts as hidden."""


class Followed(NamedTuple):
    """Tracks of N points through all T frames."""

    xy: npt.NDArray[np.float32]
    """[N, T, 2], pixels."""
    occlusion: npt.NDArray[np.float32]
    """[N, T], scores."""


class Seen(NamedTuple):
    """Points of one frame, and where their surfaces lie in all T frames."""

    xy: npt.NDArray[np.float32]
    """[N, T, 2], pixels."""
    static_confidence: npt.NDArray[np.float32]
    """[N]: 1 on the static scene."""

    @property
    def moving(self) -> npt.NDArray[np.bool_]:
        """[N]: whether the dynamic volume owns them."""
        return self.static_confidence < 1 - OBJECT_SHARE


@torch.no_grad()
def follow(model: DecoMotion, queries: npt.NDArray[np.floating]) -> Followed:
    """Tracks of `queries` [N, 3] of (t, x, y) with their occlusion, as exported models answer."""
    device = next(model.parameters()).device
    every = torch.arange(model.num_frames, device=device)
    conditioning = model.condition(every)
    xy, frame = torch.tensor(queries[:, 1:], dtype=torch.float32), torch.tensor(queries[:, 0], dtype=torch.int64)
    size = max(1, AT_ONCE // model.num_frames)
    answers = [
        answer(model, conditioning, some.to(device), of.to(device), every)
        for some, of in zip(xy.split(size), frame.split(size), strict=True)
    ]
    return Followed(
        torch.cat([each.xy for each in answers]).cpu().numpy(),
        torch.cat([each.occlusion for each in answers]).cpu().numpy(),
    )


@torch.no_grad()
def see(model: DecoMotion, frame: int, xy: npt.NDArray[np.floating], volume: str | None = None) -> Seen:
    """Where what is seen at `xy` [N, 2], pixels of `frame`, lies in all frames; with `volume`, in that one alone."""
    device = next(model.parameters()).device
    conditioning = model.condition(torch.arange(model.num_frames, device=device))
    here = PairConditioning(*(each.take(torch.tensor([frame], device=device)) for each in conditioning))
    points = torch.tensor(xy, dtype=torch.float32, device=device)[None]
    rays = model.cast(points, here)
    confidence = rays.static_confidence
    if volume is None:
        is_static, weights = static_owns(confidence), (rays.fused_static, rays.fused_dynamic)
    else:
        is_static = torch.full_like(confidence, volume == "static", dtype=torch.bool)
        weights = (rays.alone_static, rays.alone_dynamic)
    surface = surface_on(model, rays, torch.where(is_static[..., None], *weights), is_static, here)
    repeated = Surface(
        surface.canonical.expand(model.num_frames, -1, -1), surface.is_static.expand(model.num_frames, -1)
    )
    there = carry(model, repeated, conditioning).transpose(0, 1)
    return Seen(there.cpu().numpy(), confidence[0].cpu().numpy())

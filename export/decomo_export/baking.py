"""Surfaces: what is seen at a pixel of a frame. Rendered when asked, or looked up in a table that was rendered before.

A table covers each frame with a raster whose longer side is `SIDE` at most. It holds 16-bit codes: of pseudo-depth
(`depth`), or of the canonical position (`full`); their sign is the volume that owns the pixel, negative for the dynamic
one. Between four pixels the owner is the volume with the larger bilinear weight, and only its pixels are averaged: an
outline stays an outline.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from copy import deepcopy
from typing import Literal

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from tqdm import tqdm

from decomo_export.frame import FrameModel
from decomo_export.frozen_rays import FrozenModel, Hit, Part
from decomo_export.lookup import LookupTable, Raster
from decomotion.device import choose_device
from decomotion.geometry import ImagePlane
from decomotion.model.fusion import DecoMotion, PairConditioning
from decomotion.pseudo_depth import FAR

Bake = Literal["none", "depth", "full"]
SIDE = 256
"""Longest side of a table's raster: the finest grids of the `cpu` preset have half as many cells."""
LEVELS = 2**15
"""Codes of each volume."""
RAYS_AT_ONCE = {"cpu": 1 << 11, "cuda": 1 << 15}
"""By kind of device: so few that their samples stay in a core's cache; so many that a GPU is kept busy."""
LONG = 5.0
"""Seconds after which a bar is shown: `paper` takes hours on a CPU."""

LARGEST_KEPT = 31 << 20
"""Bytes. Once it has freed a block of that size, glibc keeps smaller ones for the next array; until then it gives each
back to the system, which clears its pages again: a third of the time."""


def build_surfaces(model: DecoMotion, frozen: FrozenModel, bake: Bake) -> Rendered | BakedSurfaces:
    """The source of surfaces: called with pixels [2, point] and frames [point], it gives a `Hit`."""
    if bake == "none":
        return Rendered(frozen)
    return BakedSurfaces(model, canonical=bake == "full")


class Rendered(nn.Module):
    """Surfaces by rendering the rays."""

    def __init__(self, model: FrozenModel) -> None:
        super().__init__()
        self.model = model

    def forward(self, xy: Float[Tensor, "2 point"], frame: Int[Tensor, " point"]) -> Hit:
        """The surface at pixels `xy` of each point's `frame`."""
        return self.model.cast(xy, frame).hit()

    def canonical(
        self,
        part: Part,
        values: Float[Tensor, "1 point"],
        xy: Float[Tensor, "2 point"],
        frame: Int[Tensor, " point"],
    ) -> Float[Tensor, "3 point"]:
        """Canonical positions of the surface points `part.asked`, of which the rest are the columns."""
        return part.volume.to_canonical(xy, values.T, frame)


class BakedSurfaces(LookupTable):
    """Surfaces from a table of codes, int16 [row, column, frame, channel]; see the module's docstring.

    Args:
        model: what is rendered into the table: on a GPU where there is one, else by as many threads as torch has.
        canonical: whether the table holds canonical positions (three channels) or pseudo-depth (one).
    """

    scale: Tensor
    offset: Tensor
    codes: Tensor
    lowest: Tensor
    step: Tensor

    def __init__(self, model: DecoMotion, *, canonical: bool) -> None:
        super().__init__(Raster(model.num_frames, *table_size(model.plane)), "codes")
        self.holds_canonical = canonical
        scale = torch.tensor([[self.raster.width / model.plane.width], [self.raster.height / model.plane.height]])
        self.register_buffer("scale", scale)
        self.register_buffer("offset", scale / 2 - 0.5)
        self._encode(*self._render(model))

    def forward(self, xy: Float[Tensor, "2 point"], frame: Int[Tensor, " point"]) -> Hit:
        """The surface at pixels `xy` of each point's `frame`."""
        cell, within = self.raster(xy * self.scale + self.offset, frame)
        right, down = within.split(1)
        across = torch.cat([1 - right, right])
        weights = torch.cat([across * (1 - down), across * down])
        if self.unfolds:
            corners = self._rows().index_select(0, cell).to(torch.float32).T.unflatten(0, (4, -1))
        else:
            corners = self.raster.corners(self.codes, cell).to(torch.float32)
        codes = corners + 0.5  # sign: owner; magnitude: code and a half
        signed = weights[:, None] * codes
        total, magnitude = signed.sum(0), signed.abs().sum(0)
        owners = codes[:, 0].clamp(-0.5, 0.5)  # half of their sign
        balance = 2 * (weights * owners).sum(0)  # static weight less dynamic weight
        is_static = balance >= 0
        owner = torch.where(is_static, 1.0, -1.0)
        return Hit((magnitude + owner * total) / (1 + owner * balance), is_static)

    def canonical(
        self,
        part: Part,
        values: Float[Tensor, "channel point"],
        xy: Float[Tensor, "2 point"],
        frame: Int[Tensor, " point"],
    ) -> Float[Tensor, "3 point"]:
        """Canonical positions of the surface points `part.asked`, of which the rest are the columns."""
        owner = int(part.is_static)
        found = values * self.step[owner] + self.lowest[owner]
        return found if self.holds_canonical else part.volume.to_canonical(xy, found.T, frame)

    def _rows(self) -> Int[Tensor, "cell corner_channel"]:
        """A row for each cell: its corners, row by row; a runtime computes them, once, when it loads."""
        upper, lower = self.codes[:-1], self.codes[1:]
        corners = torch.cat([upper[:, :-1], upper[:, 1:], lower[:, :-1], lower[:, 1:]], dim=-1)
        return corners.flatten(0, 2)

    def _render(self, model: DecoMotion) -> tuple[Float[Tensor, "frame channel pixel"], Bool[Tensor, "frame pixel"]]:
        """Values and owners of all pixels of all frames, row by row."""
        raster, count = self.raster, model.num_frames
        device = torch.device(choose_device("auto"))
        on_gpu = device.type != "cpu"
        model = deepcopy(model).to(device) if on_gpu else model
        at_once = RAYS_AT_ONCE[device.type]
        y, x = torch.meshgrid(torch.arange(raster.height), torch.arange(raster.width), indexing="ij")
        pixels = ((torch.stack([x, y]).flatten(1) - self.offset) / self.scale).to(device).split(at_once, dim=1)
        values = torch.empty(count, 3 if self.holds_canonical else 1, x.numel())
        is_static = torch.empty(count, x.numel(), dtype=torch.bool)
        with torch.no_grad():
            conditioning = model.condition(torch.arange(count, device=device))

        @torch.no_grad()
        def render(frame: int) -> None:
            row = torch.tensor([frame], device=device)
            seen = FrameModel(model, PairConditioning(*(volume.take(row) for volume in conditioning)))
            for part, found, owners in zip(
                pixels, values[frame].split(at_once, 1), is_static[frame].split(at_once), strict=True
            ):
                hit = seen.hit(part)
                found.copy_(seen.canonical(part, hit) if self.holds_canonical else hit.values)
                owners.copy_(hit.is_static)

        torch.empty(LARGEST_KEPT, dtype=torch.uint8)
        threads = 1 if on_gpu else torch.get_num_threads()
        with _one_thread_each(), ThreadPoolExecutor(threads) as pool:
            try:
                rendered = pool.map(render, range(count))
                for _ in tqdm(rendered, "surfaces", count, leave=False, delay=LONG, disable=None):
                    pass
            finally:
                pool.shutdown(cancel_futures=True)
        return values, is_static

    def _encode(self, values: Float[Tensor, "frame channel pixel"], is_static: Bool[Tensor, "frame pixel"]) -> None:
        count, channels, _ = values.shape
        lowest, step = torch.zeros(2, channels, 1), torch.ones(2, channels, 1)
        for owner in (False, True):
            low, high = self._range(values, is_static == owner)
            apart = (high - low).clamp_min(1e-6) / (LEVELS - 1)
            lowest[int(owner)], step[int(owner)] = low - apart / 2, apart  # `forward` finds codes and a half
        codes = torch.empty(self.raster.height, self.raster.width, count, channels, dtype=torch.int16)
        for frame, (of_frame, owners) in enumerate(zip(values, is_static, strict=True)):
            static, dynamic = (((of_frame - lowest[owner]) / step[owner] - 0.5).round() for owner in (1, 0))
            code = torch.where(owners, static.clamp(0, LEVELS - 1), -1 - dynamic.clamp(0, LEVELS - 1))
            codes[:, :, frame] = code.to(torch.int16).T.unflatten(0, codes.shape[:2])
        self.register_buffer("codes", codes)
        self.register_buffer("lowest", lowest)
        self.register_buffer("step", step)

    def _range(
        self, values: Float[Tensor, "frame channel pixel"], owned: Bool[Tensor, "frame pixel"]
    ) -> tuple[Float[Tensor, "channel 1"], Float[Tensor, "channel 1"]]:
        """Lowest and highest value of those that are `owned`; nothing is found where none is."""
        channels = values.shape[1]
        if not (self.holds_canonical and owned.any()):
            return torch.zeros(channels, 1), torch.full((channels, 1), FAR)
        infinite = torch.tensor(torch.inf)
        lows, highs = zip(
            *(
                (torch.where(mine, of_frame, infinite).amin(1), torch.where(mine, of_frame, -infinite).amax(1))
                for of_frame, mine in zip(values, owned, strict=True)
            ),
            strict=True,
        )
        return torch.stack(lows).amin(0)[:, None], torch.stack(highs).amax(0)[:, None]


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Operators of torch run in the thread that calls them: threads that share each one wait for the slowest."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def table_size(plane: ImagePlane) -> tuple[int, int]:
    """Height and width of a table's raster: the clip's, made smaller where its longer side is above `SIDE`."""
    factor = min(1.0, SIDE / max(plane.height, plane.width))
    return max(2, round(plane.height * factor)), max(2, round(plane.width * factor))

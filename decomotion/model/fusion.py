"""DecoMotion's model: a static and a dynamic volume, rendered alone and fused (paper, Sec. 3.2)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from decomotion.compositing import composite, composite_weights, fused_weights, static_share
from decomotion.geometry import ImagePlane
from decomotion.model.config import ModelConfig
from decomotion.model.field import build_field
from decomotion.model.frame_code import build_frame_code
from decomotion.model.volume import Conditioning, EmptyVolume, Matter, Volume
from decomotion.rays import lift, sample_depths


class PairConditioning(NamedTuple):
    """Conditioning of both volumes for the same frames."""

    static: Conditioning
    dynamic: Conditioning


@dataclass(frozen=True)
class Rays:
    """Ray samples of both volumes at some pixels of some frames. Local positions are normalised."""

    xy: Float[Tensor, "batch point 2"]
    """Of the pixels, normalised."""
    depths: Float[Tensor, "batch point sample"]
    static_canonical: Float[Tensor, "batch point sample 3"]
    dynamic_canonical: Float[Tensor, "batch point sample 3"]
    static: Matter
    dynamic: Matter
    fused_static: Float[Tensor, "batch point sample"]
    """The static volume's share of each sample's weight after fusion."""
    fused_dynamic: Float[Tensor, "batch point sample"]
    """The dynamic volume's."""

    @cached_property
    def alone_static(self) -> Float[Tensor, "batch point sample"]:
        """Weights of the samples where the static volume is alone."""
        return composite_weights(self.static.density)

    @cached_property
    def alone_dynamic(self) -> Float[Tensor, "batch point sample"]:
        """And where the dynamic volume is."""
        return composite_weights(self.dynamic.density)

    @property
    def opacity(self) -> Float[Tensor, "batch point"]:
        """Total weight of the fused ray, at most 1."""
        return (self.fused_static + self.fused_dynamic).sum(-1)

    @property
    def static_confidence(self) -> Float[Tensor, "batch point"]:
        """Share of the fused weight that is static, 1 on the static scene."""
        return static_share(self.fused_static.sum(-1), self.fused_dynamic.sum(-1))

    @property
    def motion_mask_alone(self) -> Float[Tensor, "batch point"]:
        """B as printed: beta rendered in the static volume alone."""
        return (self.alone_static * self.static.confidence).sum(-1)

    def fused_colour(self) -> Float[Tensor, "batch point 3"]:
        """C_cb: colour of the fused volume."""
        return composite(self.fused_static, self.static.colour) + composite(self.fused_dynamic, self.dynamic.colour)


class Carried(NamedTuple):
    """Points of one volume that stand for its ray samples, and their weights."""

    canonical: Float[Tensor, "pair point carried 3"]
    alone: Float[Tensor, "pair point carried"]
    """Where the volume is alone."""
    fused: Float[Tensor, "pair point carried"]
    """In the fusion."""


@dataclass(frozen=True)
class Prediction:
    """What the model says of a batch of correspondences. Positions in units, colours in [0, 1]."""

    static_xy: Float[Tensor, "pair point 2"]
    dynamic_xy: Float[Tensor, "pair point 2"]
    fused_xy: Float[Tensor, "pair point 2"]
    static_rgb: Float[Tensor, "pair point 3"]
    dynamic_rgb: Float[Tensor, "pair point 3"]
    fused_rgb: Float[Tensor, "pair point 3"]
    dynamic_feature: Float[Tensor, "pair point feature"]
    motion_mask: Float[Tensor, "pair point"]
    """B, 1 on the static scene: see `ModelConfig.motion_mask`."""
    depths: Float[Tensor, "pair point sample"]
    static_weights: Float[Tensor, "pair point sample"]
    """Of the static volume alone."""
    dynamic_weights: Float[Tensor, "pair point sample"]
    """Of the dynamic volume alone."""
    static_depths: Float[Tensor, "pair point carried"]
    """Pseudo-depth in the target frame of what is carried of the static volume alone (`DecoMotion.to_carry`)."""
    dynamic_depths: Float[Tensor, "pair point carried"]
    """And of the dynamic volume."""
    acceleration: Float[Tensor, "pair smooth_point carried 3"]
    """Second difference over neighbouring frames of each carried dynamic point's local position, normalised units.

    Where the static volume is alone, of its points."""


class DecoMotion(nn.Module):
    """The fused model of one clip; with `config.volumes` one volume alone, the other an `EmptyVolume`.

    Args:
        config: sizes.
        plane: the clip's raster.
        starts: `(static, dynamic)`, each [frame, 3, 4], affine maps from local to canonical space to begin with.
        feature_size: channels of the rendered feature; 0: none.
    """

    def __init__(
        self,
        config: ModelConfig,
        plane: ImagePlane,
        starts: tuple[Float[Tensor, "frame 3 4"], Float[Tensor, "frame 3 4"]],
        feature_size: int,
    ) -> None:
        super().__init__()
        self.config = config
        self.plane = plane
        self.num_frames = len(starts[0])
        self.feature_size = feature_size
        self.frame_code = build_frame_code(config.frame_code, self.num_frames)
        extents = [canonical_extent(start, plane) for start in starts]
        size = config.frame_code.size
        has_static, has_dynamic = config.volumes != "dynamic", config.volumes != "static"
        self.static = Volume(config.static, size, starts[0], extents[0]) if has_static else EmptyVolume()
        self.dynamic = Volume(config.dynamic, size, starts[1], extents[1]) if has_dynamic else EmptyVolume()
        has_feature = has_dynamic and feature_size > 0
        self.feature_field = build_field(config.feature_field, extents[1]) if has_feature else None
        self.feature_head = nn.Linear(config.feature_field.width, feature_size) if has_feature else None

    def condition(self, frames: Int[Tensor, " frame"]) -> PairConditioning:
        """Conditioning of both volumes for `frames`: once per frame, whatever the number of points."""
        codes = self.frame_code()
        return PairConditioning(self.static.condition(codes, frames), self.dynamic.condition(codes, frames))

    def cast(
        self,
        xy: Float[Tensor, "batch point 2"],
        conditioning: PairConditioning,
        frame: Int[Tensor, " batch"] | None = None,
        offset: Float[Tensor, "batch point sample"] | None = None,
    ) -> Rays:
        """Samples the rays through pixels `xy`, at depths by `offset` (`decomotion.rays.sample_depths`)."""
        config = self.config
        batch, points = xy.shape[:2]
        depths = sample_depths(xy, config.samples, offset)
        depths = depths.expand(batch, points, config.samples)
        normalised = self.plane.normalise(xy)
        local = lift(normalised, depths).flatten(1, 2)
        shape = (batch, points, config.samples, 3)
        u = self.static.to_canonical(local, conditioning.static, frame).reshape(shape)
        v = self.dynamic.to_canonical(local, conditioning.dynamic, frame).reshape(shape)
        static, dynamic = self.static.matter(u), self.dynamic.matter(v)
        # a static volume alone has nothing to share the ray with; where there is none, the empty one's beta is 0
        beta = torch.ones_like(static.confidence) if config.volumes == "static" else static.confidence
        weights = fused_weights(static.density, dynamic.density, beta)
        return Rays(normalised, depths, u, v, static, dynamic, weights.static, weights.dynamic)

    def predict(
        self,
        xy: Float[Tensor, "pair point 2"],
        frame: Int[Tensor, " pair"],
        target_frame: Int[Tensor, " pair"],
        offset: Float[Tensor, "pair point sample"],
        smooth_points: int | None = None,
    ) -> Prediction:
        """Everything that the losses look at, for points `xy` of `frame` and where they are in `target_frame`.

        Positions are in units, unlike those of `cast`: what is optimised does not depend on the clip's size. `offset`
        is that of `cast`.

        The acceleration is computed for the first `smooth_points` of each pair; None: for all.
        """
        middle = frame.clamp(1, max(1, self.num_frames - 2))
        rows = torch.cat([frame, target_frame, middle - 1, middle, middle + 1]).clamp(max=self.num_frames - 1)
        needed = torch.arange(self.num_frames, device=rows.device)
        if len(rows) < self.num_frames:
            needed, rows = rows, needed[: len(rows)]
        conditioning = self.condition(needed)
        here, there, *around = (
            PairConditioning(conditioning.static.take(row), conditioning.dynamic.take(row)) for row in rows.chunk(5)
        )
        rays = self.cast(self.plane.from_units(xy), here, offset=offset)
        (static, of_static, fused_static), (dynamic, of_dynamic, fused_dynamic) = self.to_carry(rays, here)
        u = self.static.from_canonical(static.flatten(1, 2), there.static).reshape(static.shape)
        v = self.dynamic.from_canonical(dynamic.flatten(1, 2), there.dynamic).reshape(dynamic.shape)
        fused = composite(fused_static, u) + composite(fused_dynamic, v)
        # a deferred point of the fusion means nothing where its volume has no part in it
        alone = 1 if self.config.deferred else None
        return Prediction(
            static_xy=self._project(composite(of_static, u), rays.alone_static.sum(-1)),
            dynamic_xy=self._project(composite(of_dynamic, v), rays.alone_dynamic.sum(-1)),
            fused_xy=self._project(fused, rays.opacity),
            static_rgb=composite(rays.alone_static, rays.static.colour),
            dynamic_rgb=composite(rays.alone_dynamic, rays.dynamic.colour),
            fused_rgb=rays.fused_colour(),
            dynamic_feature=self._render_feature(of_dynamic, dynamic),
            motion_mask=rays.motion_mask_alone if self.config.motion_mask == "static" else rays.static_confidence,
            depths=rays.depths,
            static_weights=rays.alone_static,
            dynamic_weights=rays.alone_dynamic,
            static_depths=u[..., :alone, 2],
            dynamic_depths=v[..., :alone, 2],
            acceleration=self._acceleration((static[..., :alone, :], dynamic[..., :alone, :]), smooth_points, around),
        )

    def to_carry(self, rays: Rays, conditioning: PairConditioning) -> tuple[Carried, Carried]:
        """The points that stand for each volume's samples of `rays`, cast in the frames of `conditioning`.

        They are the samples themselves or, where the model is `deferred`, two points: the ray's points at the mean of
        the samples' depths, weighted as in the volume alone and as in the fusion, which take their whole weight.
        """
        if not self.config.deferred:
            return (
                Carried(rays.static_canonical, rays.alone_static, rays.fused_static),
                Carried(rays.dynamic_canonical, rays.alone_dynamic, rays.fused_dynamic),
            )
        return (
            self._deferred(rays, (rays.alone_static, rays.fused_static), self.static, conditioning.static),
            self._deferred(rays, (rays.alone_dynamic, rays.fused_dynamic), self.dynamic, conditioning.dynamic),
        )

    def _deferred(
        self,
        rays: Rays,
        weights: tuple[Float[Tensor, "pair point sample"], Float[Tensor, "pair point sample"]],
        volume: Volume | EmptyVolume,
        conditioning: Conditioning,
    ) -> Carried:
        totals = torch.stack([of.sum(-1) for of in weights], dim=-1)
        depths = torch.stack([(of * rays.depths).sum(-1) for of in weights], dim=-1) / totals.clamp_min(1e-3)
        local = lift(rays.xy, depths)
        points = volume.to_canonical(local.flatten(1, 2), conditioning).reshape(local.shape)
        return Carried(points, *torch.diag_embed(totals).unbind(-2))

    def _project(self, local: Float[Tensor, "*batch 3"], opacity: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch 2"]:
        xy = local[..., :2]
        if self.config.normalise_weights:
            xy = xy / opacity[..., None].clamp_min(1e-3)
        return self.plane.to_units(self.plane.to_pixels(xy))

    def _render_feature(
        self, weights: Float[Tensor, "*batch carried"], canonical: Float[Tensor, "*batch carried 3"]
    ) -> Float[Tensor, "*batch feature"]:
        """Paper, Eq. 3. The head is linear, so it is applied after compositing: the same sum, a sample's cost."""
        if self.feature_field is None or self.feature_head is None:
            return weights.new_zeros((*weights.shape[:-1], 0))
        hidden = self.feature_field(canonical.reshape(-1, 3)).reshape(*canonical.shape[:-1], -1)
        return (
            composite(weights, hidden) @ self.feature_head.weight.T
            + weights.sum(-1, keepdim=True) * self.feature_head.bias
        )

    def _acceleration(
        self,
        carried: tuple[Float[Tensor, "pair point carried 3"], Float[Tensor, "pair point carried 3"]],
        smooth_points: int | None,
        around: list[PairConditioning],
    ) -> Float[Tensor, "pair smooth_point carried 3"]:
        """x_{i-1} + x_{i+1} - 2 x_i of what is carried of the volume in which objects move: the dynamic one,
        if there is.

        At the clip's ends it is taken about the nearest inner frame.
        """
        alone = self.config.volumes == "static"
        volume = self.static if alone else self.dynamic
        canonical = carried[0 if alone else 1][:, :smooth_points]
        if self.num_frames < 3:
            return torch.zeros_like(canonical)
        flat = canonical.flatten(1, 2)
        frames = [conditioning.static if alone else conditioning.dynamic for conditioning in around]
        before, at, after = (volume.from_canonical(flat, conditioning) for conditioning in frames)
        return (before + after - 2 * at).reshape(canonical.shape)


def canonical_extent(start: Float[Tensor, "frame 3 4"], plane: ImagePlane) -> Float[Tensor, "3"]:
    """Half the size of a box about the origin that holds all frames' volumes under their starting maps."""
    side = plane.half_side
    half = start.new_tensor([plane.width / 2 / side, plane.height / 2 / side, 1.0])
    signs = torch.cartesian_prod(*[start.new_tensor([-1.0, 1.0])] * 3)
    corners = signs * half
    mapped = corners @ start[..., :3].transpose(-1, -2) + start[:, None, :, 3]
    return (mapped.abs().amax(dim=(0, 1)) * 1.05).clamp(max=MAX_EXTENT)


MAX_EXTENT = 8.0
"""Canonical boxes end here, in image half-widths: a camera that pans farther reuses the border's cells."""

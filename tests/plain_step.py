"""The paper preset's computation written out plainly: pair by pair, every network on every sample, nothing shared.

No conditioning computed once a frame, no split first layer, no head after compositing, inverses by `linalg.inv`, sums
along rays as loops. It reads the weights of a `DecoMotion` and gives the `Prediction` that it should give.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from decomotion.model.coupling import LOG_SCALE_LIMIT, CouplingLayer
from decomotion.model.field import GaborField
from decomotion.model.fusion import DecoMotion, Prediction
from decomotion.model.volume import Volume


def affine_map(volume: Volume, code: Tensor, frame: int) -> tuple[Tensor, Tensor]:
    """A [3, 3] and b [3] of one frame."""
    correction = volume.affine.correction(code).reshape(3, 4) / volume.affine.hidden
    both = volume.affine.start[frame] + correction
    return both[:, :3], both[:, 3]


def scale_and_shift(layer: CouplingLayer, points: Tensor, code: Tensor) -> tuple[Tensor, Tensor]:
    """Log-scale and shift at points [point, 3]: the whole MLP, the code joined to every point."""
    conditioner = layer.conditioner
    plane = points @ layer.basis[:2].T
    waves = [plane]
    angles = (plane[:, :, None] * conditioner.frequencies).flatten(1)
    waves += [torch.sin(angles), torch.cos(angles)]
    encoded = F.leaky_relu(conditioner.encode(torch.cat(waves, dim=-1)))
    joined = torch.cat([encoded, conditioner.project_code(code).expand(len(points), -1)], dim=-1)
    weight = torch.cat([conditioner.from_plane.weight, conditioner.from_code.weight], dim=-1)
    hidden = F.leaky_relu(F.linear(joined, weight, conditioner.from_code.bias))
    for linear in conditioner.hidden:
        hidden = F.leaky_relu(F.linear(hidden, linear.weight, linear.bias))
    output = conditioner.output(hidden)
    return output[:, 0].clamp(-LOG_SCALE_LIMIT, LOG_SCALE_LIMIT), output[:, 1]


def to_canonical(volume: Volume, points: Tensor, code: Tensor, frame: int) -> Tensor:
    matrix, offset = affine_map(volume, code, frame)
    points = (points - points.new_tensor([0.0, 0.0, 1.0])) @ matrix.T + offset
    for layer in volume.couplings:
        log_scale, shift = scale_and_shift(layer, points, code)
        along = points @ layer.basis[2]
        points = points + (along * torch.exp(log_scale) + shift - along)[:, None] * layer.basis[2]
    return points


def from_canonical(volume: Volume, points: Tensor, code: Tensor, frame: int) -> Tensor:
    for layer in reversed(list(volume.couplings)):
        log_scale, shift = scale_and_shift(layer, points, code)
        along = points @ layer.basis[2]
        points = points + ((along - shift) / torch.exp(log_scale) - along)[:, None] * layer.basis[2]
    matrix, offset = affine_map(volume, code, frame)
    return (points - offset) @ torch.linalg.inv(matrix).T + points.new_tensor([0.0, 0.0, 1.0])


def gabor(field: GaborField, points: Tensor) -> Tensor:
    """The hidden layer of a GaborNet at points [point, 3]."""
    norm = points.norm(dim=-1, keepdim=True)
    points = torch.where(norm > 1, (2 - 1 / norm.clamp_min(1)) * points / norm, points)
    hidden = None
    for number, one in enumerate(field.filters):
        distance = (points[:, None] - one.centre).square().sum(-1)
        value = torch.sin(one.linear(points)) * torch.exp(-one.gamma / 2 * distance)
        before = field.linears[number - 1] if number else None
        hidden = value if before is None else value * F.linear(hidden, before.weight, before.bias)
    return hidden


def along_ray(density: Tensor) -> Tensor:
    """T_k [point, sample] of a density, sample by sample."""
    through, light = [], torch.ones_like(density[:, 0])
    for sample in range(density.shape[1]):
        through.append(light)
        light = light * torch.exp(-density[:, sample])
    return torch.stack(through, dim=1)


def predict_pair(
    model: DecoMotion, xy: Tensor, frame: int, target: int, depths: Tensor, smooth_points: int
) -> dict[str, Tensor]:
    """The prediction for the points [point, 2] of one pair with their sample depths [point, sample].

    Points lie on the raster that covers the frame and whose longer side is 256.
    """
    codes = model.frame_code()
    points, samples = depths.shape
    middle = xy.new_tensor([model.plane.width, model.plane.height]) * (128 / max(model.plane.width, model.plane.height))
    normalised = (xy + 0.5 - middle) / 128
    local = torch.cat([normalised[:, None].expand(-1, samples, -1), depths[..., None]], dim=-1)
    found: dict[str, Tensor] = {"depths": depths}
    canonical, there, density, colour, beta = {}, {}, {}, {}, torch.zeros(())
    for name, volume in (("static", model.static), ("dynamic", model.dynamic)):
        flat = to_canonical(volume, local.reshape(-1, 3), codes[frame], frame)
        raw = volume.head(gabor(volume.field, flat)).reshape(points, samples, 5)
        there[name] = from_canonical(volume, flat, codes[target], target).reshape(points, samples, 3)
        canonical[name], density[name] = flat.reshape(points, samples, 3), F.softplus(raw[..., 3] - 1)
        colour[name] = torch.sigmoid(raw[..., :3])
        beta = torch.sigmoid(raw[..., 4]) if name == "static" else beta
        alone = along_ray(density[name]) * (1 - torch.exp(-density[name]))
        found[f"{name}_weights"], found[f"{name}_depths"] = alone, there[name][..., 2]
        found[f"{name}_xy"] = (alone[..., None] * there[name]).sum(1)[:, :2] * 128 + middle - 0.5
        found[f"{name}_rgb"] = (alone[..., None] * colour[name]).sum(1)
    through = along_ray(beta * density["static"] + (1 - beta) * density["dynamic"])
    static = through * beta * (1 - torch.exp(-density["static"]))
    dynamic = through * (1 - beta) * (1 - torch.exp(-density["dynamic"]))
    fused = (static[..., None] * there["static"] + dynamic[..., None] * there["dynamic"]).sum(1)
    found["fused_xy"] = fused[:, :2] * 128 + middle - 0.5
    found["fused_rgb"] = (static[..., None] * colour["static"] + dynamic[..., None] * colour["dynamic"]).sum(1)
    found["motion_mask"] = (found["static_weights"] * beta).sum(1)
    features = model.feature_head(gabor(model.feature_field, canonical["dynamic"].reshape(-1, 3)))
    weights = found["dynamic_weights"][..., None]
    found["dynamic_feature"] = (weights * features.reshape(points, samples, -1)).sum(1)
    middle = min(max(frame, 1), model.num_frames - 2)
    smooth = canonical["dynamic"][:smooth_points].reshape(-1, 3)
    before, at, after = (from_canonical(model.dynamic, smooth, codes[i], i) for i in (middle - 1, middle, middle + 1))
    found["acceleration"] = (before + after - 2 * at).reshape(smooth_points, samples, 3)
    return found


def predict(
    model: DecoMotion, xy: Tensor, frame: Tensor, target_frame: Tensor, depths: Tensor, smooth_points: int
) -> Prediction:
    """As `DecoMotion.predict`, with the depths [pair, point, sample] that it drew."""
    pairs = [
        predict_pair(model, xy[row], int(frame[row]), int(target_frame[row]), depths[row], smooth_points)
        for row in range(len(frame))
    ]
    found = {name: torch.stack([pair[name] for pair in pairs]) for name in pairs[0]}
    return Prediction(**found)

"""Batches: pairs of frames with correspondences between them, drawn from the pool."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Generator, Tensor

from decomotion.config import OptimConfig
from decomotion.data.pool import UNKNOWN_MOTION, Pool


@dataclass(frozen=True)
class Batch:
    """Correspondences of some frame pairs. Positions in pixels."""

    frame: Int[Tensor, " pair"]
    target_frame: Int[Tensor, " pair"]
    point: Int[Tensor, "pair point"]
    """Index of each point among its frame's points in the pool."""
    xy: Float[Tensor, "pair point 2"]
    target_xy: Float[Tensor, "pair point 2"]
    confidence: Float[Tensor, "pair point"]
    """In [0, 1]; 0 where the target is not known."""
    rgb: Float[Tensor, "pair point 3"]
    """The clip's colour at `xy`, in [0, 1]."""
    feature: Float[Tensor, "pair point feature"]
    """The dense feature at `xy`, of unit norm."""
    moving: Float[Tensor, "pair point"]
    """The motion mask M at `xy`: 1 on what moves."""
    masked: Float[Tensor, "pair point"]
    """1 where there is a motion mask, 0 where M is not known."""

    def pairs(self, begin: int, end: int) -> Batch:
        """The pairs `begin` to `end`."""
        return Batch(**{field.name: getattr(self, field.name)[begin:end] for field in fields(Batch)})

    def to(self, device: torch.device) -> Batch:
        """The batch on another device."""
        return Batch(**{field.name: getattr(self, field.name).to(device) for field in fields(Batch)})


class Sampler:
    """Draws batches; points whose error was large when last seen are drawn more often.

    Args:
        pool: the prepared correspondences.
        config: sizes of a batch and share of hard points.
    """

    def __init__(self, pool: Pool, config: OptimConfig) -> None:
        self._pool = pool
        self._config = config
        self.errors = torch.ones(pool.num_frames, pool.num_points)
        """[frame, point]: running mean of each point's position error in pixels (OmniMotion's error maps)."""
        self._cumulated = _cumulated_rarity(pool) if config.count_maps else None

    def draw(self, longest_gap: int, generator: Generator) -> Batch:
        """A batch whose pairs are at most `longest_gap` frames apart."""
        pool, config = self._pool, self._config
        frames = pool.num_frames
        frame = torch.randint(frames, (config.pairs,), generator=generator)
        gap = torch.randint(1, longest_gap + 1, (config.pairs,), generator=generator)
        ahead = torch.rand(config.pairs, generator=generator) < 0.5
        target = torch.where(ahead, frame + gap, frame - gap)
        mirrored = torch.where(ahead, frame - gap, frame + gap)
        target = torch.where((target >= 0) & (target < frames), target, mirrored)
        target = torch.where(
            (target >= 0) & (target < frames), target, torch.where(frame * 2 < frames, frame + 1, frame - 1)
        )
        point = self._draw_points(frame, generator)

        i, j, p = frame.numpy()[:, None], target.numpy()[:, None], point.numpy()
        moving = pool.moving[i, p]
        return Batch(
            frame=frame,
            target_frame=target,
            point=point,
            xy=_tensor(pool.points[i, p]),
            target_xy=_tensor(pool.targets[i, j, p]),
            confidence=_tensor(pool.confidence[i, j, p]) / 255,
            rgb=_tensor(pool.rgb[i, p]) / 255,
            feature=_tensor(pool.feature[i, p]),
            moving=_tensor(moving == 1),
            masked=_tensor(moving != UNKNOWN_MOTION),
        )

    def _draw_points(self, frame: Int[Tensor, " pair"], generator: Generator) -> Int[Tensor, "pair point"]:
        config = self._config
        hard = round(config.points * config.hard_mining)
        shape = (len(frame), config.points - hard)
        if self._cumulated is None:
            drawn = torch.randint(self._pool.num_points, shape, generator=generator)
        else:
            drawn = torch.searchsorted(self._cumulated[frame], torch.rand(shape, generator=generator))
            drawn = drawn.clamp(max=self._pool.num_points - 1)
        if not hard:
            return drawn
        # a tournament of 4: the one with the largest known error of four random points
        rivals = torch.randint(self._pool.num_points, (len(frame), hard, 4), generator=generator)
        winner = self.errors[frame[:, None, None], rivals].argmax(dim=-1, keepdim=True)
        return torch.cat([drawn, rivals.gather(-1, winner)[..., 0]], dim=-1)

    def note_errors(self, batch: Batch, error: Float[Tensor, "pair point"]) -> None:
        """Remembers the position errors in pixels of a batch; those of unknown targets are left out."""
        frame = batch.frame[:, None].expand_as(batch.point)
        old = self.errors[frame, batch.point]
        self.errors[frame, batch.point] = torch.where(batch.confidence > 0, 0.5 * old + 0.5 * error, 0.9 * old)


def _cumulated_rarity(pool: Pool) -> Float[Tensor, "frame point"]:
    """Cumulated probabilities of each frame's points: rarely linked ones are likelier, by 1 / sqrt(count + 1)."""
    counts = np.stack([(confidence > 0).sum(axis=0) for confidence in pool.confidence])
    rarity = np.cumsum(1 / np.sqrt(counts + 1.0), axis=-1)
    return torch.from_numpy((rarity / rarity[:, -1:]).astype(np.float32))


def _tensor(values: np.ndarray) -> Float[Tensor, "..."]:
    return torch.from_numpy(np.ascontiguousarray(values).astype(np.float32))

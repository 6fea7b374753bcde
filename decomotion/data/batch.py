"""Batches: pairs of frames with correspondences between them, drawn from the pool."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt
import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Generator, Tensor

from decomotion.data.pool import UNKNOWN_MOTION, Pool
from decomotion.data.surroundings import Expected, expected
from decomotion.schedule import OptimConfig
from decomotion.units import to_units


@dataclass(frozen=True)
class Batch:
    """Correspondences of some frame pairs. Positions in units (`decomotion.units`)."""

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
    expected_xy: Float[Tensor, "pair point 2"]
    """Where points are expected whose target is not known (`decomotion.data.surroundings`)."""
    expected_weight: Float[Tensor, "pair point"]
    """In [0, 1]; 0 where the target is known, or nothing around."""

    def pairs(self, begin: int, end: int) -> Batch:
        """The pairs `begin` to `end`."""
        return Batch(**{field.name: getattr(self, field.name)[begin:end] for field in fields(Batch)})

    def to(self, device: torch.device) -> Batch:
        """The batch on another device."""
        return Batch(**{field.name: getattr(self, field.name).to(device) for field in fields(Batch)})


WhichLinks = Callable[[npt.NDArray, npt.NDArray, npt.NDArray], npt.NDArray[np.bool_]]
"""Tells some links by their frame, target frame and point."""


class Sampler:
    """Draws batches; points whose error was large when last seen are drawn more often.

    Args:
        pool: the prepared correspondences.
        config: sizes of a batch and share of hard points.
        held_out: links whose target is unknown to all batches; None: none.
        frame_weights: [frame], how often points are drawn from each; None: from all as often.
    """

    def __init__(
        self,
        pool: Pool,
        config: OptimConfig,
        held_out: WhichLinks | None = None,
        frame_weights: npt.NDArray[np.floating] | None = None,
    ) -> None:
        self._pool = pool
        self._config = config
        self._held_out = held_out
        self._frame_weights = None if frame_weights is None else _tensor(frame_weights)
        self.errors = torch.ones(pool.num_frames, pool.num_points)
        """[frame, point]: running mean of each point's position error in units (OmniMotion's error maps)."""
        self._hard = round(config.points * config.hard_mining)
        self._hidden = round(config.points * config.hidden_share)
        uniform = not config.count_maps and config.moving_share == 0
        self._cumulated = None if uniform else _cumulated_probability(pool, config)

    def draw(self, longest_gap: int, generator: Generator) -> Batch:
        """A batch whose pairs are at most `longest_gap` frames apart.

        Points with a known target are taken first, then the share of hidden ones, and those drawn by their error come
        last: smoothness is evaluated at the first (`DecoMotion.predict`).
        """
        pool, config = self._pool, self._config
        frames = pool.num_frames
        if self._frame_weights is None:
            frame = torch.randint(frames, (config.pairs,), generator=generator)
        else:
            frame = torch.multinomial(self._frame_weights, config.pairs, replacement=True, generator=generator)
        gap = torch.randint(1, longest_gap + 1, (config.pairs,), generator=generator)
        ahead = torch.rand(config.pairs, generator=generator) < 0.5
        target = torch.where(ahead, frame + gap, frame - gap)
        mirrored = torch.where(ahead, frame - gap, frame + gap)
        target = torch.where((target >= 0) & (target < frames), target, mirrored)
        target = torch.where(
            (target >= 0) & (target < frames), target, torch.where(frame * 2 < frames, frame + 1, frame - 1)
        )
        candidates = self._draw_points(frame, generator)
        i, j = frame.numpy()[:, None], target.numpy()[:, None]
        known = torch.from_numpy(self._known(i, j, candidates.numpy()))
        order = _first(known > 0)
        hidden = order[:, order.shape[1] - self._hidden :]
        chosen = torch.cat([order[:, : config.points - self._hidden], hidden], dim=1)
        told = self._expected(i, j, candidates, known, hidden)
        last = _first(chosen >= self._hard)
        chosen = chosen.gather(1, last)
        point = candidates.gather(1, chosen)

        p = point.numpy()
        moving = pool.moving[i, p]
        return Batch(
            frame=frame,
            target_frame=target,
            point=point,
            xy=_tensor(to_units(pool.points[i, p], pool.longer_side)),
            target_xy=_tensor(to_units(pool.targets[i, j, p], pool.longer_side)),
            confidence=known.gather(1, chosen).float() / 255,
            rgb=_tensor(pool.rgb[i, p]) / 255,
            feature=_tensor(pool.feature[i, p]),
            moving=_tensor(moving == 1),
            masked=_tensor(moving != UNKNOWN_MOTION),
            expected_xy=_behind(told.xy, config.points).gather(1, last[..., None].expand(-1, -1, 2)),
            expected_weight=_behind(told.weight, config.points).gather(1, last),
        )

    def _expected(
        self,
        frame: npt.NDArray[np.int64],
        target: npt.NDArray[np.int64],
        candidates: Int[Tensor, "pair candidate"],
        known: UInt8[Tensor, "pair candidate"],
        hidden: Int[Tensor, "pair hidden"],
    ) -> Expected:
        """Of the candidates `hidden`: by structure where they stand still, else by what is around them.

        Around them are those candidates of which the target is known and which move, or stand, as they do.
        """
        pool, points = self._pool, candidates.numpy()
        moving = torch.from_numpy(np.ascontiguousarray(pool.moving[frame, points]))
        its_moving = moving.gather(1, hidden)
        xy = _tensor(to_units(pool.points[frame, points], pool.longer_side))
        found = expected(
            xy.gather(1, hidden[..., None].expand(-1, -1, 2)),
            xy,
            _tensor(to_units(pool.targets[frame, target, points], pool.longer_side)),
            (its_moving[..., None] == moving[:, None]) * (known[:, None].float() / 255),
        )
        if pool.structure is not None:
            which = candidates.gather(1, hidden).numpy()
            unknown = pool.confidence[frame, target, which] == 0  # structure has seen links that are held out
            placed = torch.from_numpy(unknown & (pool.structure.agreement[frame, which] > 0)) & (its_moving != 1)
            by_structure = pool.structure.expected(frame, target, which)
            found = Expected(
                torch.where(placed[..., None], by_structure.xy, found.xy),
                torch.where(placed, by_structure.weight, found.weight),
            )
        return Expected(found.xy, torch.where(known.gather(1, hidden) > 0, 0.0, found.weight))

    def _known(
        self, frame: npt.NDArray[np.int64], target: npt.NDArray[np.int64], point: npt.NDArray[np.int64]
    ) -> npt.NDArray[np.uint8]:
        """Confidence of links, 0 of those that are held out."""
        confidence = self._pool.confidence[frame, target, point]
        return confidence if self._held_out is None else np.where(self._held_out(frame, target, point), 0, confidence)

    def _draw_points(self, frame: Int[Tensor, " pair"], generator: Generator) -> Int[Tensor, "pair point"]:
        """`candidates` times as many points as a batch needs; the hard ones among them come first."""
        config, hard = self._config, self._hard
        shape = (len(frame), config.points * config.candidates - hard)
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
        return torch.cat([rivals.gather(-1, winner)[..., 0], drawn], dim=-1)

    def note_errors(self, batch: Batch, error: Float[Tensor, "pair point"]) -> None:
        """Remembers a batch's position errors in units; where the target is unknown, what was remembered decays."""
        frame = batch.frame[:, None].expand_as(batch.point)
        old = self.errors[frame, batch.point]
        self.errors[frame, batch.point] = torch.where(batch.confidence > 0, 0.5 * old + 0.5 * error, 0.9 * old)


def _first(which: Bool[Tensor, "pair candidate"]) -> Int[Tensor, "pair candidate"]:
    """An order of each pair's candidates in which `which` come first, otherwise as they were."""
    return torch.argsort((~which).to(torch.uint8), dim=-1, stable=True)


def _behind(values: Float[Tensor, "pair hidden *rest"], points: int) -> Float[Tensor, "pair point *rest"]:
    """The values of the last of so many points, 0 of the others."""
    before = values.new_zeros(len(values), points - values.shape[1], *values.shape[2:])
    return torch.cat([before, values], dim=1)


def _cumulated_probability(pool: Pool, config: OptimConfig) -> Float[Tensor, "frame point"]:
    """Cumulated probabilities of each frame's points."""
    weight = np.ones(pool.moving.shape)
    if config.count_maps:
        counts = np.stack([(confidence > 0).sum(axis=0) for confidence in pool.confidence])
        weight /= np.sqrt(counts + 1.0)
    if config.moving_share:
        weight *= _balance(np.asarray(pool.moving) == 1, config.moving_share)
    cumulated = np.cumsum(weight, axis=-1)
    return torch.from_numpy((cumulated / cumulated[:, -1:]).astype(np.float32))


def _balance(moving: npt.NDArray[np.bool_], least: float) -> npt.NDArray[np.float64]:
    """Weights [frame, point] that draw at least the share `least` of a frame's points from what moves.

    The scene keeps half of `least` at least, or what that leaves. A frame where all or nothing moves is left as it is.
    """
    share = moving.mean(axis=-1, keepdims=True)
    most = max(least, 1 - least / 2)
    wanted = np.where((share > 0) & (share < 1), np.clip(share, least, most), share)
    return np.where(moving, wanted / np.maximum(share, 1e-9), (1 - wanted) / np.maximum(1 - share, 1e-9))


def _tensor(values: np.ndarray) -> Float[Tensor, "..."]:
    return torch.from_numpy(np.ascontiguousarray(values).astype(np.float32))

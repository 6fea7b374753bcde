"""The supervision of a short fit: a pool like any other (`decomotion.data.pool`), in memory.

The points of every frame are

- random ones, whose links are the finished model's own answers: what is far from the corrections has nothing to learn;
- those of the trusted tracks;
- those around corrected points in the frames in which they are hidden, which are to belong to the other volume.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from decomotion.corrections.following import see
from decomotion.corrections.trusted import REACH, Bent, TrustedTracks, contradiction, offsets_around
from decomotion.data.pool import UNKNOWN_MOTION, Pool
from decomotion.data.positions import PackedPositions, pack
from decomotion.data.prepare import Preparation
from decomotion.data.sampling import bilinear
from decomotion.frames import AnyFrames
from decomotion.geometry import ImagePlane
from decomotion.model.fusion import DecoMotion

STAYING = 1024
"""Random points of a frame, at least; there are as many as of the other kinds together."""
COVERING, FEWEST = 512, 16
"""Points of what hides corrected points, about, and at least so many where it hides one in a frame."""


@dataclass(frozen=True, eq=False)
class _Points:
    """Some of the points of one frame."""

    xy: npt.NDArray[np.floating]
    """[N, 2], pixels."""
    targets: npt.NDArray[np.floating]
    """[N, T, 2], pixels."""
    confidence: npt.NDArray[np.floating]
    """[N, T]."""
    moving: npt.NDArray[np.integer]
    """[N], as the pool's."""


def lesson_pool(
    model: DecoMotion,
    prepared: Preparation,
    frames: AnyFrames,
    tracks: TrustedTracks,
    random: np.random.Generator,
) -> Pool:
    """The pool of the short fit.

    Args:
        model: the finished model.
        prepared: the supervision that it was fitted to.
        frames: of the clip.
        tracks: the trusted tracks.
        random: draws the points whose links stay.
    """
    pool, plane = prepared.pool, model.plane
    hiding = [(each, int(frame)) for each in tracks.bent for frame in each.point.hidden]
    covering = max(COVERING // max(1, len(hiding)), FEWEST)
    count = max(STAYING, len(tracks.xy))
    columns: dict[str, list[Any]] = {
        name: [] for name in ("points", "targets", "confidence", "rgb", "feature", "moving")
    }
    for frame in range(pool.num_frames):
        kinds = [
            _staying(model, tracks.bent, frame, _places(pool, frame, count, plane, random)),
            _trusted(tracks, frame),
            *(_covering(model, each, hidden, frame, covering) for each, hidden in hiding),
        ]
        xy = _inside(np.concatenate([kind.xy for kind in kinds]), plane).astype(np.float32)
        confidence = np.concatenate([kind.confidence for kind in kinds])
        confidence[:, frame] = 0
        columns["points"].append(xy)
        columns["targets"].append(pack(np.concatenate([kind.targets for kind in kinds]), pool.longer_side))
        columns["confidence"].append(np.round(255 * confidence).astype(np.uint8))
        columns["rgb"].append(np.round(bilinear(frames[frame], xy)).astype(np.uint8))
        columns["feature"].append(pool.feature[frame, _cells(xy, prepared.grid, plane.height, plane.width)])
        columns["moving"].append(np.concatenate([kind.moving for kind in kinds]).astype(np.uint8))
    stacked: dict[str, Any] = {name: np.stack(each) for name, each in columns.items()}
    targets = PackedPositions(stacked.pop("targets").swapaxes(1, 2), pool.longer_side)
    stacked["confidence"] = stacked["confidence"].swapaxes(1, 2)
    return Pool(**stacked, targets=targets, camera=pool.camera, object=pool.object, longer_side=pool.longer_side)


def _places(
    pool: Pool, frame: int, count: int, plane: ImagePlane, random: np.random.Generator
) -> npt.NDArray[np.floating]:
    """[count, 2]: random places of a frame, half of them on what moves there: objects are small, and move first."""
    anywhere = _inside(random.random((count, 2)) * (plane.width, plane.height) - 0.5, plane)
    moving = pool.points[frame, pool.moving[frame] == 1]
    if len(moving):
        anywhere[: count // 2] = random.choice(moving, count // 2)
    return anywhere


def _inside(xy: npt.NDArray[np.floating], plane: ImagePlane) -> npt.NDArray[np.floating]:
    """Places [N, 2]; those beyond the outermost pixels' centres are brought there, and asked about there."""
    return xy.clip(0, (plane.width - 1, plane.height - 1))


def _staying(model: DecoMotion, bent: Sequence[Bent], frame: int, xy: npt.NDArray[np.floating]) -> _Points:
    """Links as the model has them: less surely where it does not know the owner, and where corrections contradict."""
    every, unit = np.arange(model.num_frames)[None], model.plane.unit
    seen = see(model, frame, xy)
    wrong = contradiction(bent, np.full((1, 1), frame), xy[:, None], every, seen.xy, unit)
    moving = seen.moving.astype(np.uint8)
    for each in bent:
        near = np.linalg.norm(xy - each.xy[frame], axis=-1) < REACH * unit
        moving[near & ((moving != each.moving) | (frame in each.point.hidden))] = UNKNOWN_MOTION
    return _Points(xy, seen.xy, np.abs(2 * seen.static_confidence - 1)[:, None] * (1 - wrong), moving)


def _trusted(tracks: TrustedTracks, frame: int) -> _Points:
    confidence = np.minimum(tracks.trust, tracks.trust[:, frame, None])
    moving = np.where(tracks.trust[:, frame] > 0, tracks.moving, UNKNOWN_MOTION)
    return _Points(tracks.xy[:, frame], tracks.xy, confidence, moving)


def _covering(model: DecoMotion, bent: Bent, hidden: int, frame: int, count: int) -> _Points:
    """What hides a point in frame `hidden`: it moves as the other volume does there. Says nothing of other frames."""
    places = _inside(bent.xy[hidden] + offsets_around(count, REACH * model.plane.unit), model.plane)
    if frame != hidden or model.config.volumes != "fused":
        nowhere = np.zeros((count, model.num_frames))
        unknown = np.full(count, UNKNOWN_MOTION)
        return _Points(places, np.broadcast_to(places[:, None], (*nowhere.shape, 2)), nowhere, unknown)
    seen = see(model, hidden, places, "static" if bent.moving else "dynamic")
    near = np.exp(-0.5 * (np.linalg.norm(places - bent.xy[hidden], axis=-1) / (REACH * model.plane.unit)) ** 2)
    trust = np.broadcast_to(near[:, None], (count, model.num_frames)).copy()
    return _Points(places, seen.xy, trust, np.full(count, int(not bent.moving)))


def _cells(xy: npt.NDArray[np.float32], grid: tuple[int, int], height: int, width: int) -> npt.NDArray[np.int64]:
    """[N]: the points of the pool's jittered grid of (rows, columns) in whose cells `xy` [N, 2] lie."""
    x, y = ((xy + 0.5) * np.array([grid[1] / width, grid[0] / height])).astype(np.int64).T
    return y.clip(0, grid[0] - 1) * grid[1] + x.clip(0, grid[1] - 1)

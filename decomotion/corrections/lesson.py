"""The supervision of a short fit: a pool like any other (`decomotion.data.pool`), in memory.

Its points are, in every frame, those of the trusted tracks, those at which a corrected point is hidden, and random ones
whose links are the finished model's own answers: what is far from the corrections has nothing to learn, and stays.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from decomotion.corrections.following import see
from decomotion.corrections.trusted import REACH, Bent, TrustedTracks, contradiction
from decomotion.data.pool import UNKNOWN_MOTION, PackedPositions, Pool, pack
from decomotion.data.sampling import bilinear
from decomotion.frames import AnyFrames
from decomotion.model.fusion import DecoMotion
from decomotion.model.readout import OBJECT_SHARE

ANCHORS = 1024
"""Random points of a frame that stay, at least; there are as many as trusted ones."""


def lesson(
    model: DecoMotion, pool: Pool, frames: AnyFrames, tracks: TrustedTracks, random: np.random.Generator
) -> Pool:
    """The pool of the short fit.

    Args:
        model: the finished model, which is asked.
        pool: what it was fitted to.
        frames: of the clip.
        tracks: the trusted tracks.
        random: draws the points that stay.
    """
    length, unit, side = pool.num_frames, model.plane.unit, pool.longer_side
    count = max(ANCHORS, len(tracks.xy))
    covers = _covers(model, tracks)
    points, rgb, feature, moving, targets, confidence = [], [], [], [], [], []
    every = np.arange(length)
    size = np.array([model.plane.width, model.plane.height])
    for frame in range(length):
        here = np.full((1, 1), frame)
        stay = (random.random((count, 2)) * size - 0.5).astype(np.float32)
        seen = see(model, frame, stay)
        wrong = contradiction(tracks.bent, here, stay[:, None], every[None], seen.xy, unit)
        sure = np.abs(2 * seen.static_confidence - 1)[:, None] * (1 - wrong)
        owner = (seen.static_confidence < 1 - OBJECT_SHARE).astype(np.uint8)
        owner[_uncertain(tracks.bent, frame, stay, unit)] = UNKNOWN_MOTION
        given = np.minimum(tracks.trust, tracks.trust[:, frame, None])
        cover = covers[frame]
        at = np.concatenate([stay, tracks.xy[:, frame], cover[0]]).clip(0, size - 1).astype(np.float32)
        points.append(at)
        rgb.append(bilinear(frames[frame], at))
        nearest = ((pool.points[frame][None] - at[:, None]) ** 2).sum(-1).argmin(1)
        feature.append(pool.feature[frame][nearest])
        moving.append(np.concatenate([owner, tracks.moving, cover[3]]))
        targets.append(pack(np.concatenate([seen.xy, tracks.xy, cover[1]]), side))
        conf = np.concatenate([sure, given, cover[2]])
        conf[:, frame] = 0
        confidence.append(np.round(255 * conf).astype(np.uint8))
    return Pool(
        points=np.stack(points),
        targets=PackedPositions(np.stack(targets).swapaxes(1, 2), side),
        confidence=np.stack(confidence).swapaxes(1, 2),
        rgb=np.stack(rgb).astype(np.uint8),
        feature=np.stack(feature),
        moving=np.stack(moving).astype(np.uint8),
        camera=pool.camera,
        object=pool.object,
        longer_side=side,
        thinned=pool.thinned,
    )


def _uncertain(bent, frame, xy, unit):
    near = np.zeros(len(xy), bool)
    for each in bent:
        near |= np.linalg.norm(xy - each.xy[frame], axis=-1) < 2 * REACH * unit
    return near


def _covers(model, tracks):
    length = model.num_frames
    empty = (np.zeros((0, 2)), np.zeros((0, length, 2)), np.zeros((0, length)), np.zeros(0))
    return [empty] * length

"""Evidence of motion against one scene: what is the scene in some frames is the scene in all.

Where an object fills a frame, the motion that explains most between it and another may be the object's. Such pairs of
frames are told from the others (`agreement.py`). What the others say is carried along links to where they say nothing,
and the camera of such a pair is fitted to what is not known to move.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from decomotion.data.masks.agreement import Agreement
from decomotion.data.masks.cameras import Cameras, Floats, Mask
from decomotion.data.masks.evidence import Evidence, in_units, motion_evidence
from decomotion.data.masks.labelling import log_odds, thresholds
from decomotion.data.masks.links import Links
from decomotion.frames import AnyFrames

GAPS = (1, 2, 4, 6, 8)
"""Over which labels are carried."""
AGREES = 0.5
"""Pairs that follow the scene are at least so far on its side, of 1."""
SWEEPS = 2
"""Forth and back."""


def consistent_evidence(
    frames: AnyFrames, links: Links, random: np.random.Generator, progress: bool = False
) -> Evidence:
    """Evidence of motion of all frames, against the same scene.

    Args:
        frames: [frame, h, w, 3], of which a few are in memory at a time.
        links: of the clip.
        random: draws the points that geometry is fitted to.
        progress: show a progress bar.
    """
    height, width = in_units(frames[0]).shape[:2]
    cameras, agreement = Cameras(links, height, width, random), Agreement()
    found = motion_evidence(frames, links, cameras, range(len(links)), progress, agreement)
    sides = agreement.of_pairs(thresholds(found.residual))
    doubtful = {pair: cameras.forget(pair) for pair in cameras.pairs() if sides[pair] < AGREES}
    if not doubtful:
        return found
    changed = sorted({frame for pair in doubtful for frame in pair})
    found = replaced(found, motion_evidence(frames, links, cameras, changed, progress), changed)
    moving = heard(found, links) > 0
    for pair, former in doubtful.items():
        cameras.mend(pair, ~moving[pair[0]], unlike=former if sides[pair] < 0 else None)
    found = replaced(found, motion_evidence(frames, links, cameras, changed, progress), changed)
    return replace(found, heard=np.where(np.isnan(found.residual), heard(found, links), 0))


def replaced(found: Evidence, anew: Evidence, some: list[int]) -> Evidence:
    """`found`, and `anew` in some frames."""
    here = np.isin(np.arange(len(found.residual)), some)[:, None]
    pairs = ((found.residual, anew.residual), (found.change, anew.change))
    residual, change = (np.where(here, after, before) for before, after in pairs)
    return replace(found, residual=residual, change=change)


def heard(evidence: Evidence, links: Links) -> Floats:
    """What each point does, [frame, point], 1 moves, -1 does not, by its own evidence or that of others along links."""
    known = ~np.isnan(evidence.residual)
    return carried(np.tanh(log_odds(evidence.residual, evidence.change) / 2), known, links)


def carried(spins: Floats, known: Mask, links: Links) -> Floats:
    """`spins` where they are `known` [frame, point], and elsewhere what links bring from there, 0 where nothing.

    Points that are not known hear each other too, the less the less they know.
    """
    frames = len(spins)
    spins, sure = np.where(known, spins, 0).astype(np.float32), known.astype(np.float32)
    wanting: list[int] = np.flatnonzero(~known.all(axis=1)).tolist()
    for order in (wanting, wanting[::-1]) * SWEEPS:
        for frame in order:
            total, most = np.zeros((spins.shape[1], 2), np.float32), np.full(spins.shape[1], 1e-3, np.float32)
            for other in _around(frame, frames):
                weight = links.weight(frame, other)
                heard = links.read(np.stack([spins[other] * sure[other], sure[other]], axis=-1), frame, other)
                total += weight[:, None] * heard
                most += weight
            value, weight = total.T
            spins[frame] = np.where(known[frame], spins[frame], value / np.maximum(weight, 1e-3))
            sure[frame] = np.where(known[frame], 1, weight / most)
    return spins


def _around(frame: int, frames: int) -> list[int]:
    """The other frames, of so many, that `frame` hears."""
    around = (frame + sign * gap for gap in GAPS for sign in (1, -1))
    return [other for other in around if 0 <= other < frames]

"""Evidence of motion against one scene: what is the scene in some frames is the scene in all.

Where an object fills the frame, the motion that explains most is the object's. Labels of that frame then contradict
those of others along links: what moves there stands here. Frames whose labels agree are found as the part of a signed
graph that hangs together, the larger side of it; their labels are carried along links into the other frames, and where
the camera between two frames follows what is known to move, it is fitted to the rest.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from decomotion.data.masks.cameras import Cameras, Floats, neighbours
from decomotion.data.masks.evidence import Evidence, in_units, motion_evidence
from decomotion.data.masks.labelling import log_odds
from decomotion.data.masks.links import Links
from decomotion.frames import AnyFrames

COMPARED = (1, 2, 4, 6, 8)
"""Gaps over which labels are compared and carried."""
CONTINUITY = 1e-3
"""By which labels of successive frames agree where no links tell."""
AGREES = 0.5
"""Share of the agreement of the best frame that a frame has at least."""
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
    cameras = Cameras(links, height, width, random)
    found = motion_evidence(frames, links, cameras, range(len(links)), progress)
    spins = np.tanh(log_odds(found.residual, found.change) / 2)
    agree = agreeing(spins, links)
    if agree.all():
        return found
    moving = carried(spins, agree, links) > 0
    changed = {
        each
        for frame in range(len(links))
        for other in neighbours(frame, len(links))
        if frame < other and not agree[[frame, other]].all() and cameras.mend(frame, other, moving[frame])
        for each in (frame, other)
    }
    mended, some = motion_evidence(frames, links, cameras, changed, progress), sorted(changed)
    for array, anew in ((found.residual, mended.residual), (found.change, mended.change)):
        array[some] = anew[some]
    return found


def agreeing(spins: Floats, links: Links) -> npt.NDArray[np.bool_]:
    """Which frames call the same things moving, [frame]: the larger side where there are two.

    `spins` [frame, point] are 1 on what moves and -1 on what does not. The agreement of two frames is the mean product
    of their spins along links. Sides are the signs of the leading eigenvector of the normalised matrix of agreements,
    as in spectral clustering of signed graphs (Kunegis et al. 2010); frames between them are small in it.
    """
    frames = len(spins)
    agreement = CONTINUITY * (np.eye(frames, k=1) + np.eye(frames, k=-1))
    for frame in range(frames):
        for other in _compared(frame, frames):
            product = links.weight(frame, other) * spins[frame] * links.read(spins[other], frame, other)
            agreement[[frame, other], [other, frame]] += product.mean() / 2
    degree = np.maximum(np.abs(agreement).sum(axis=0), CONTINUITY)
    leading = np.linalg.eigh(agreement / np.sqrt(np.outer(degree, degree)))[1][:, -1]
    side = leading / np.sqrt(degree)
    side *= np.sign((side * degree).sum())
    return side > AGREES * np.abs(side).max()


def carried(spins: Floats, known: npt.NDArray[np.bool_], links: Links) -> Floats:
    """`spins` [frame, point] of the `known` frames, and in the others what links bring from them, 0 where nothing.

    Frames that are not known hear each other too, the less the less they know.
    """
    frames = len(spins)
    spins = np.where(known[:, None], spins, 0).astype(np.float32)
    sure = np.repeat(known[:, None], spins.shape[1], axis=1).astype(np.float32)
    others: list[int] = np.flatnonzero(~known).tolist()
    for order in (others, others[::-1]) * SWEEPS:
        for frame in order:
            total, most = np.zeros((spins.shape[1], 2), np.float32), np.full(spins.shape[1], 1e-3, np.float32)
            for other in _compared(frame, frames):
                weight = links.weight(frame, other)
                heard = links.read(np.stack([spins[other] * sure[other], sure[other]], axis=-1), frame, other)
                total += weight[:, None] * heard
                most += weight
            value, weight = total.T
            spins[frame] = value / np.maximum(weight, 1e-3)
            sure[frame] = weight / most
    return spins


def _compared(frame: int, frames: int) -> list[int]:
    """The other frames, of so many, that the labels of `frame` are compared with."""
    around = (frame + sign * gap for gap in COMPARED for sign in (1, -1))
    return [other for other in around if 0 <= other < frames]

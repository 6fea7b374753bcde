"""Structure from motion: what stands still is one rigid body, which tells where its points are while they are hidden.

Points lie at X in projective space, and frame t sees them at x_t = P_t X, where P_t is a 3x4 matrix (Hartley and
Zisserman 2004, chapters 6 and 18). Cameras and points are fitted to the links. No lens is assumed and none is found:
what is asked for is where points are seen, not where they are. Where a camera only turns, or stands, depths are not
told, and do not matter.

Coordinates of frames are units (`decomotion.units`) / 128 - 1, from -1 to 1 along the longer side; X is (X, Y, Z, 1).

equations.py    what least squares need to know of the links
cameras.py      cameras, by a sample of the points
places.py       where each point of the pool lies
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch

from decomotion.data.positions import Positions
from decomotion.data.structure.cameras import SAMPLE, fit_cameras
from decomotion.data.structure.equations import DEVIATION, HALF, NEAREST, Floats
from decomotion.data.structure.places import frames_to_place_by, place
from decomotion.data.surroundings import Expected
from decomotion.units import to_units

Indices = npt.NDArray[np.integer]


@dataclass(frozen=True)
class Structure:
    """Cameras, and the places of the pool's points."""

    cameras: npt.NDArray[np.float32]
    """P, [frame, 3, 4]."""
    places: npt.NDArray[np.float32]
    """X, [frame, point, 3]."""
    covariance: npt.NDArray[np.float32]
    """Of `places`, [frame, point, 3, 3]."""
    agreement: npt.NDArray[np.float32]
    """[frame, point]: share of a point's links that are of this rigid body; 0 where too few are known to tell."""

    def expected(self, frame: Indices, target: Indices, point: Indices) -> Expected:
        """Where points of a frame are seen in a target frame; the three are broadcast against each other.

        The weight is the point's agreement, and half of that where the standard deviation is `DEVIATION`.
        """
        cameras, x = self.cameras[target], self.places[frame, point]
        seen = (cameras[..., :3] @ x[..., None])[..., 0] + cameras[..., 3]
        depth = seen[..., 2:].clip(min=NEAREST)
        at = seen[..., :2] / depth
        slope = (cameras[..., :2, :3] - at[..., None] * cameras[..., 2:, :3]) / depth[..., None]
        variance = ((slope @ self.covariance[frame, point]) * slope).sum(axis=(-1, -2))
        weight = self.agreement[frame, point] / (1 + variance / DEVIATION**2)
        return Expected(torch.from_numpy((at + 1) * np.float32(HALF)), torch.from_numpy(weight))


def structure(
    points: Floats,
    targets: Positions,
    confidence: npt.NDArray[np.uint8],
    still: npt.NDArray[np.bool_],
    sides: tuple[int, int],
    random: np.random.Generator,
) -> Structure:
    """Cameras by what stands still; every point is placed by them.

    Args:
        points: [frame, point, 2], pixels of the clip.
        targets: [frame, frame, point, 2], as in the pool.
        confidence: [frame, frame, point], as in the pool.
        still: [frame, point], which do not move by themselves.
        sides: height and width of the clip.
        random: draws the points that cameras are fitted to.
    """
    frames = len(points)
    every = np.arange(frames)

    def links(frame: int, which: Indices | slice, others: Indices) -> tuple[Floats, Floats]:
        """Where points of a frame are seen in others, [point, frame, 2], and how much that counts, [point, frame]."""
        xy = np.stack([targets[frame, other][which] for other in others], axis=1)
        counts = np.stack([confidence[frame, other][which] for other in others], axis=1) / 255.0
        own = others == frame
        xy[:, own], counts[:, own] = points[frame][which][:, None], 1.0
        return to_units(xy.astype(np.float64), *sides) / HALF - 1, counts**2

    drawn = []
    for frame in range(frames):
        those = np.flatnonzero(still[frame])
        chosen = random.choice(those, min(len(those), -(-SAMPLE // frames)), replace=False)
        drawn.append((*links(frame, chosen, every), np.tile(np.abs(every - frame), (len(chosen), 1))))
    seen, counts, gap = (np.concatenate(each) for each in zip(*drawn, strict=True))
    cameras = fit_cameras(seen, counts, gap, random)
    places, covariance, agreement = (
        np.empty((frames, points.shape[1], *shape), np.float32) for shape in ((3,), (3, 3), ())
    )
    for frame in range(frames):
        by = frames_to_place_by(frame, frames)
        placed = place(*links(frame, slice(None), by), cameras[by], by - frame)
        places[frame], covariance[frame], agreement[frame] = placed
    return Structure(cameras.astype(np.float32), places, covariance, agreement)

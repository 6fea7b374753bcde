"""How a frame differs from the scene, which the frames around show.

What moves by itself does not look like what is behind it, and there its links may follow that. The scene is brought
from frames around by the motion of what stands still, and left unknown where something may cover it.

All is on the raster of units, frames whose longer side is 256.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt

from decomotion.data.masks.auto import moves_at
from decomotion.data.masks.cameras import MIN_VALID, Model, draw, fit_homography
from decomotion.data.masks.evidence import in_units, quantile
from decomotion.data.masks.links import Links
from decomotion.frames import AnyFrames

Floats = npt.NDArray[np.float32]
Image = npt.NDArray[np.uint8]
Mask = npt.NDArray[np.bool_]

AROUND = (-8, -4, -2, 2, 4, 8)
"""Frames so far away show the scene."""
COVERED = 6
"""Units around a mask where another frame does not show the scene."""
LEAST = 12.0
"""Grey levels, the mean of three channels, by which what moves differs from the scene."""


def differences(
    frames: AnyFrames, masks: Sequence[Mask], probability: Floats, links: Links, random: np.random.Generator
) -> Iterator[Floats]:
    """How much each pixel of each frame differs from the scene, as `difference` has it.

    Args:
        frames: [frame, H, W, 3], of which a few are in memory at a time.
        masks: [h, w] of each frame, what may cover the scene.
        probability: [frame, row, column], that each point of the grid moves.
        links: between the points.
        random: draws the links that the scene's motion is fitted to.
    """
    sides = in_units(frames[0]).shape[:2]
    stands = [~moves_at(values, xy, sides) for values, xy in zip(probability, links.points, strict=True)]

    @lru_cache(2 * max(AROUND) + 1)
    def shown(frame: int) -> tuple[Image, Mask]:
        return in_units(frames[frame]), wider(masks[frame], COVERED)

    for frame in range(len(masks)):
        others = [frame + gap for gap in AROUND if 0 <= frame + gap < len(masks)]
        seen = ((shown(other), _scene_motion(links, frame, other, stands[frame], random)) for other in others)
        views = [_brought_here(*there, motion) for there, motion in seen if motion is not None]
        yield difference(shown(frame)[0], views)


def difference(image: Image, views: list[Floats]) -> Floats:
    """How much each pixel of `image` [h, w, 3] differs from the scene, [h, w], in grey levels; NaN where it is unknown.

    The scene is the median of `views` [h, w, 3], NaN where one does not show it. It may lie a pixel off.
    """
    if not views:
        return np.full(image.shape[:2], np.nan, np.float32)
    scene = quantile(views, 0.5)
    unknown = np.isnan(scene[..., 0])
    scene[unknown] = 0
    least = np.full(image.shape[:2], np.inf, np.float32)
    for shift in np.ndindex(3, 3):
        shifted = np.roll(scene, (shift[0] - 1, shift[1] - 1), (0, 1))
        least = np.minimum(least, cv2.blur(np.abs(image - shifted).mean(axis=-1), (3, 3)))
    return np.where(unknown, np.float32(np.nan), least)


def _scene_motion(links: Links, frame: int, other: int, stands: Mask, random: np.random.Generator) -> Model | None:
    """Homography of what `stands` [point], from `frame` to `other`; None where too little of it is seen in both."""
    seen = stands & (links.weight(frame, other) > 0)
    if seen.sum() < MIN_VALID:
        return None
    drawn = draw(seen.astype(np.float64), random)
    return fit_homography(links.points[frame][drawn], links.target(frame, other)[drawn])


def _brought_here(image: Image, covered: Mask, motion: Model) -> Floats:
    """Another frame [h, w, 3] as the scene lies in this one, NaN where it does not show it."""
    size = image.shape[1::-1]
    there = cv2.warpPerspective(image, motion, size, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
    shows = cv2.warpPerspective(
        (~covered).astype(np.uint8), motion, size, flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
    )
    return np.where(shows[..., None] > 0, there, np.float32(np.nan)).astype(np.float32)


def wider(mask: Mask, radius: int) -> Mask:
    """A mask and `radius` pixels around it."""
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    return cv2.dilate(mask.view(np.uint8), disc).astype(np.bool_)

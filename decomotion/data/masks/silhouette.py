"""Silhouettes: masks `auto`, with the limbs that the scene's motion has swallowed.

A limb whose flow follows what is behind it does not move relative to the scene, by its links. It does not look like the
scene either (`decomotion/data/masks/scene.py`). So what is near a mask counts as moving where it differs from the
scene, and its rim only there.

All is on the raster of units, frames whose longer side is 256.
"""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
import numpy.typing as npt

from decomotion.data.masks.auto import rendered
from decomotion.data.masks.evidence import in_units
from decomotion.data.masks.links import Links
from decomotion.data.masks.scene import LEAST, differences, wider
from decomotion.frames import AnyFrames

Floats = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

NEAR = 16
"""Units around a mask in which its limbs lie; the scene around them, as wide, says how well it is known."""
CORE = 2
"""Units inside a mask: nearer to its outline, what looks like the scene is the scene."""
ORDINARY = 0.9
"""The scene around is so different from itself at most, but for this share of it."""
SMALLEST = 3
"""Units; what is narrower is noise."""


def silhouettes(frames: AnyFrames, probability: Floats, links: Links, random: np.random.Generator) -> Iterator[Mask]:
    """What moves, [h, w] of each frame, on the raster of units; arguments as of `differences`."""
    masks = rendered(probability, in_units(frames[0]).shape[:2])
    for mask, different in zip(masks, differences(frames, list(masks), probability, links, random), strict=True):
        yield silhouette(mask, different)


def silhouette(mask: Mask, different: Floats) -> Mask:
    """What of a frame moves, [h, w], from its `mask` and how much it differs from the scene (`difference`)."""
    near = wider(mask, NEAR)
    beyond = different[wider(mask, 2 * NEAR) & ~near & ~np.isnan(different)]
    least = max(LEAST, float(np.quantile(beyond, ORDINARY))) if len(beyond) else LEAST
    core = cv2.erode(mask.view(np.uint8), np.ones((2 * CORE + 1, 2 * CORE + 1), np.uint8)).astype(np.bool_)
    found = core | (near & np.where(np.isnan(different), mask, different > least))
    return wider(cv2.medianBlur(found.view(np.uint8), SMALLEST).astype(np.bool_), 1)

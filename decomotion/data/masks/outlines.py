"""Masks whose outlines a network draws: links say what moves, the network how far it reaches.

Links lose thin parts, whose flow follows what is behind them; the network has them, and things besides that stand
still. So a part that it outlines counts where most of it is in the mask, and with it its legs, as far as a limb
reaches, but for what looks like the scene that the frames around show. What is in the mask and far from all such parts
stays: the network does not see all that moves.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import cv2
import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from decomotion.data.masks.auto import rendered
from decomotion.data.masks.evidence import in_units
from decomotion.data.masks.links import Links
from decomotion.data.masks.scene import LEAST, differences
from decomotion.frames import AnyFrames
from decomotion.units import unit

Floats = npt.NDArray[np.float32]
Picture = npt.NDArray[np.uint8]
Mask = npt.NDArray[np.bool_]
Network = Callable[[Picture], Floats]
"""How much each pixel [h, w] of a picture [h, w, 3] belongs to what stands out in it: `decomotion.data.masks.isnet`."""

PARTS = 2
"""Of a mask, the largest: the network looks at each by itself."""
SMALLEST = 12.0
"""Units, the side of the smallest square of which it is asked."""
TOGETHER = 4.0
"""Units between what is one part."""
AROUND = 1.0
"""Of a part's longer side is shown on each side of it."""
LIMB = 24.0
"""Units from the mask that what is outlined reaches at most."""
RIM = 5.0
"""Units around what is outlined that are the mask's blurred rim."""


def outlined(
    frames: AnyFrames,
    probability: Floats,
    links: Links,
    network: Network,
    random: np.random.Generator,
    progress: bool = False,
) -> Iterator[Mask]:
    """What moves, [H, W] of each frame.

    Args:
        frames: [frame, H, W, 3].
        probability: [frame, row, column], that each point of the grid moves.
        links: between the points.
        network: draws the outlines.
        random: draws the links that the scene's motion is fitted to.
        progress: show a progress bar.
    """
    masks, told = rendered(probability, frames.shape[1:3]), []
    for frame, mask in zip(tqdm(frames, "outlines", disable=not progress, leave=False), masks, strict=True):
        told.append(outline(mask, stands_out(frame, mask, network)))
    covering = [in_units(np.uint8(255) * each) > 127 for each in told]
    for mask, found, different in zip(
        masks, told, differences(frames, covering, probability, links, random), strict=True
    ):
        yield but_for_scene(found, mask, different)


def stands_out(frame: Picture, mask: Mask, network: Network) -> Floats:
    """How much each pixel [H, W] belongs to what stands out around the parts of its `mask`; 0 elsewhere."""
    found = np.zeros(mask.shape, np.float32)
    for box in boxes(mask):
        found[box] = np.maximum(found[box], network(np.ascontiguousarray(frame[box])))
    return found


def boxes(mask: Mask) -> list[tuple[slice, slice]]:
    """Rows and columns around the largest parts of a mask [H, W]."""
    length = unit(*mask.shape)
    side = 2 * round(TOGETHER * length) + 1
    wider = cv2.dilate(mask.view(np.uint8), np.ones((side, side), np.uint8))
    _, _, parts, _ = cv2.connectedComponentsWithStats(wider)
    largest = sorted(parts[1:].tolist(), key=lambda part: -part[cv2.CC_STAT_AREA])[:PARTS]
    found = []
    for left, top, width, height, area in largest:
        if area >= (SMALLEST * length) ** 2:
            margin = round(AROUND * max(width, height))
            rows, columns = mask.shape
            found.append((_around(top, height, margin, rows), _around(left, width, margin, columns)))
    return found


def outline(mask: Mask, likely: Floats) -> Mask:
    """What moves, [H, W], by the `mask` that links tell, and how likely each pixel stands out."""
    length = unit(*mask.shape)
    reach = _distance(mask) < LIMB * length
    told = _union(mask, (part & reach for part in _parts(likely > 0.5) if 2 * (part & mask).sum() > part.sum()))
    away = _distance(told)
    return told | _union(mask, (part for part in _parts(mask & ~told) if away[part].max() > RIM * length))


def but_for_scene(found: Mask, mask: Mask, different: Floats) -> Mask:
    """What is `found` to move [H, W], without what is not in the mask and looks like the scene for the most part.

    `different` says how much each pixel [h, w], on the raster of units, differs from it: `difference`.
    """
    alike = cv2.resize((different < LEAST).view(np.uint8), mask.shape[::-1], interpolation=cv2.INTER_NEAREST) > 0
    return found & ~_union(mask, (part for part in _parts(found & ~mask) if 2 * (part & alike).sum() > part.sum()))


def _around(first: int, size: int, margin: int, of: int) -> slice:
    """`size` from `first` on with a margin, of so many; what has no room before an edge is added on the other side."""
    wanted = min(of, size + 2 * margin)
    begin = min(max(0, first - margin), of - wanted)
    return slice(begin, begin + wanted)


def _parts(mask: Mask) -> Iterator[Mask]:
    count, labels = cv2.connectedComponents(mask.view(np.uint8), connectivity=8)
    return (labels == number for number in range(1, count))


def _union(like: Mask, parts: Iterator[Mask]) -> Mask:
    union = np.zeros_like(like)
    for part in parts:
        union |= part
    return union


def _distance(mask: Mask) -> Floats:
    """From each pixel to the mask, [H, W]."""
    if not mask.any():
        return np.full(mask.shape, np.inf, np.float32)
    return cv2.distanceTransform((~mask).view(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE).astype(np.float32)

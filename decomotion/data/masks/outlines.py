"""Masks whose outlines a network draws: links say what moves, the network how far it reaches.

Links lose thin parts, whose flow follows what is behind them; the network has them, and things besides that stand
still. So what it outlines as one thing moves as one where a fair share of it is in the mask, but for what looks like
the scene that the frames around show. What is in the mask and far from all such things stays: the network does not see
all that moves. A thing that moves in one part of the clip may stand in another: each point hears, along its links,
what the frames around and far away found of it, and outlines are drawn once more.

The network takes most of the time. Of a longer clip it is asked of every second or third frame; links bring to those
between what their neighbours were told, where fast limbs may be missed.
"""

from __future__ import annotations

from bisect import bisect
from collections.abc import Callable, Iterator, Mapping, Sequence

import cv2
import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from decomotion.data.masks.auto import rendered
from decomotion.data.masks.evidence import in_units
from decomotion.data.masks.labelling import CARRIED, SMOOTHED, along_links, sigmoid
from decomotion.data.masks.links import Links
from decomotion.data.masks.scene import LEAST, differences
from decomotion.data.sampling import bilinear, nearest, pixels, rescaled
from decomotion.frames import AnyFrames
from decomotion.units import unit

Floats = npt.NDArray[np.float32]
Picture = npt.NDArray[np.uint8]
Mask = npt.NDArray[np.bool_]
Network = Callable[[Picture], Floats]
"""How much each pixel [h, w] of a picture [h, w, 3] belongs to what stands out in it: `decomotion.data.masks.isnet`."""

MOST = 64
"""Frames of which the network is asked."""
OUTLINED = 0.5
"""What stands out more than this is outlined."""
PARTS = 2
"""Of a mask, the largest: the network looks at each by itself."""
SMALLEST = 12.0
"""Units, the side of the smallest square of which it is asked."""
TOGETHER = 4.0
"""Units between what is one part."""
AROUND = 1.0
"""Of a part's longer side is shown on each side of it."""
SHARE = 0.25
"""Of what is outlined as one thing is in the mask at least, where all of it moves."""
RIM = 5.0
"""Units around what is outlined that are the mask's blurred rim."""
HEARD = 8.0
"""Log-odds from the frames around and far away, where they agree."""
DOUBT = 0.05
"""A point's own probability is this far from 0 and 1 at least."""


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

    The network is asked once of each of the frames `asked`.
    """
    masks = rendered(probability, frames.shape[1:3])
    shown = tqdm(asked(len(frames)), "outlines", disable=not progress, leave=False)
    told = {frame: stands_out(frames[frame], masks[frame], network) for frame in shown}
    out = [each > OUTLINED for each in everywhere(told, links)]
    known = (frames, out, probability, links, random)
    masks = rendered(voted(probability, list(_drawn(masks, *known)), links), frames.shape[1:3])
    return _drawn(masks, *known)


def _drawn(
    masks: npt.NDArray[np.bool_],
    frames: AnyFrames,
    out: Sequence[Mask],
    probability: Floats,
    links: Links,
    random: np.random.Generator,
) -> Iterator[Mask]:
    """What moves by `masks` and by what stands out, [H, W] of each frame."""
    found = [outline(mask, each) for mask, each in zip(masks, out, strict=True)]
    covering = [in_units(np.uint8(255) * each) > 127 for each in found]
    for mask, each, different in zip(
        masks, found, differences(frames, covering, probability, links, random), strict=True
    ):
        yield but_for_scene(each, mask, different)


def voted(probability: Floats, masks: Sequence[Mask], links: Links) -> Floats:
    """How likely points move, [frame, row, column], by their own `probability` and `masks` of other frames, [H, W]."""
    sides = in_units(masks[0].view(np.uint8)).shape[:2]
    at = [nearest(mask, rescaled(xy, sides, mask.shape)) for mask, xy in zip(masks, links.points, strict=True)]
    spins = 2 * np.stack(at).astype(np.float32) - 1
    around = [sign * gap for gap in sorted({*range(1, SMOOTHED + 1), *CARRIED}) for sign in (1, -1)]
    told = np.nan_to_num(along_links(spins, links, around, doubt=1.0)).reshape(probability.shape)
    own = np.clip(probability, DOUBT, 1 - DOUBT)
    return sigmoid(np.log(own / (1 - own)) + HEARD * told)


def asked(frames: int) -> range:
    """Of which of so many frames the network is asked: evenly spread, at most `MOST`."""
    return range(0, frames, -(-frames // MOST))


def everywhere(told: Mapping[int, Floats], links: Links) -> Iterator[Floats]:
    """What stands out [H, W] in each frame, by the first and some others that were `told`.

    Between them links bring it from the frame before and the one after; the nearer counts more.
    """
    frames = sorted(told)
    for frame in range(len(links)):
        if frame in told:
            yield told[frame]
            continue
        later = bisect(frames, frame)
        near = frames[later - 1 : later + 1]
        weights = [1 / abs(other - frame) for other in near]
        yield np.average([_brought(told[other], frame, other, links) for other in near], axis=0, weights=weights)


def _brought(values: Floats, frame: int, other: int, links: Links) -> Floats:
    """`values` [H, W] of frame `other` where the pixels of `frame` lie in it, by the links around each."""
    height, width = values.shape
    moved = (links.target(frame, other) - links.points[frame]).reshape(*links.grid, 2) * np.float32(unit(height, width))
    return bilinear(values, pixels(height, width) + cv2.resize(moved, (width, height)))[..., 0]


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


def outline(mask: Mask, out: Mask) -> Mask:
    """What moves, [H, W], by the `mask` that links tell and what stands `out`."""
    told = _union(mask, (thing for thing in _parts(out) if (thing & mask).sum() > SHARE * thing.sum()))
    away = _distance(told)
    return told | _union(mask, (part for part in _parts(mask & ~told) if away[part].max() > RIM * unit(*mask.shape)))


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

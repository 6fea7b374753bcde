"""Matches by dense SIFT, which needs no weights: every cell of one frame is compared with every cell of another.

Descriptors of two scales and the colour stand for a cell. A match is trusted where it is mutual and where cells around
it moved likewise. Positions are refined to a fraction of a cell.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor
from tqdm import tqdm

from decomotion.arrays import allocated_memmap
from decomotion.clip import Clip
from decomotion.data.features.densesift import DenseSift
from decomotion.data.features.interface import resized
from decomotion.data.features.reduction import fit_reduction
from decomotion.data.links.matcher import Matches, PairMatcher
from decomotion.data.timing import least_seconds
from decomotion.memory import forget

DESCRIBED = "descriptors.npy"
"""The descriptors of all frames."""
SIDE = 256
"""Longer side at which frames are described; the coarser scale, and the raster of descriptors, is half of it."""
CELL = 2
"""Descriptors along a cell's side."""
CHANNELS = 64
"""Of a descriptor after PCA."""
SAMPLE_STRIDE, SAMPLE_FRAMES = 4, 8
"""The PCA is of every so many-th frame, of this many frames at most."""
COLOUR_WEIGHT = 2.0
"""Of the Lab colours, in [-0.5, 0.5], beside the two SIFT descriptors of unit norm."""
COLOUR_BLUR = 1.5
"""Standard deviation in pixels with which colours are smoothed."""
REACH = 2
"""Descriptors on each side of a cell's best match among which it is refined."""
MUTUAL_CELLS = 1.5
"""A match is mutual if the way there and back ends this near to where it began."""
BLOCK = 256
"""Cells that are compared at a time with all of another frame."""
NEIGHBOURHOOD = 2
"""Cells around a match that are asked whether they moved likewise: up to this many rows and columns away."""
LIKEWISE_CELLS = 0.75
"""Displacements that differ by less than this are alike."""


class SiftMatcher:
    """See `Matcher`.

    Args:
        supporters: of the cells around a match, how many have to move likewise for it to be trusted.
    """

    def __init__(self, supporters: int) -> None:
        self._supporters = supporters

    def describe(self, clip: Clip, folder: Path, progress: bool) -> PairMatcher:
        """Descriptors of all frames lie in `folder` while pairs are matched."""
        maps = describe(clip, folder / DESCRIBED, progress)

        def match(first: int, second: int) -> tuple[Matches, Matches]:
            both = self.both_ways(*(torch.from_numpy(maps[frame].astype(np.float32)) for frame in (first, second)))
            forget(maps)
            return both

        return match

    def seconds(self, clip: Clip) -> tuple[float, float]:
        """By the time of one frame, and of one pair of frames that show anything."""
        sift, frame = DenseSift(), clip.frames[0]
        rows, columns = _describe(frame, sift).shape[:2]
        anything = torch.cos(torch.arange(rows * columns * CHANNELS).float()).reshape(rows, columns, CHANNELS)
        of_frame = least_seconds(lambda: _describe(frame, sift))
        return of_frame, least_seconds(lambda: self.both_ways(anything, anything))

    def both_ways(self, a: Float[Tensor, "h w channel"], b: Float[Tensor, "h w channel"]) -> tuple[Matches, Matches]:
        """Matches of two frames by their descriptors, there and back."""
        with torch.inference_mode():
            cells_a, cells_b = _pooled(a), _pooled(b)
            best_ab, best_ba = _nearest(cells_a, cells_b)
            return self._judged(cells_a, b, best_ab, best_ba), self._judged(cells_b, a, best_ba, best_ab)

    def _judged(
        self,
        cells: Float[Tensor, "row column channel"],
        other: Float[Tensor, "h w channel"],
        best: Int[Tensor, " cell"],
        back: Int[Tensor, " other"],
    ) -> Matches:
        mutual = _returns(best, back, cells.shape[1])
        displacement = _refined(cells, other, best, mutual)
        mutual = mutual.reshape(displacement.shape[:2])
        trusted = mutual & (supporters(displacement, mutual) >= self._supporters)
        return Matches(displacement.numpy(), trusted.numpy())


def describe(clip: Clip, file: Path, progress: bool = False) -> np.memmap:
    """Descriptors of every frame, float16 [frame, h, w, channel] of unit norm, mapped from a new `file`."""
    sift = DenseSift()
    sampled = range(0, len(clip), max(SAMPLE_STRIDE, -(-len(clip) // SAMPLE_FRAMES)))
    samples = {frame: _describe(clip.frames[frame], sift) for frame in sampled}
    reduce = fit_reduction(np.stack([sample[::2, ::2] for sample in samples.values()]), CHANNELS)
    maps = allocated_memmap(file, np.float16, (len(clip), *samples[0].shape[:2], CHANNELS))
    for frame in tqdm(range(len(clip)), "describe", disable=not progress, leave=False):
        described = samples.pop(frame) if frame in samples else _describe(clip.frames[frame], sift)
        maps[frame] = reduce(described)
        forget(maps)
    return maps


def _describe(frame: npt.NDArray[np.uint8], sift: DenseSift) -> npt.NDArray[np.float32]:
    """[h, w, channel] on half the raster of the reduced frame: SIFT at two scales and the smoothed colour."""
    fine = resized(frame, SIDE, multiple=2 * CELL)
    lab = cv2.cvtColor(cv2.GaussianBlur(fine, (0, 0), COLOUR_BLUR), cv2.COLOR_RGB2LAB)
    colour = COLOUR_WEIGHT * (lab.astype(np.float32) / 255 - 0.5)
    halved = (fine.shape[1] // 2, fine.shape[0] // 2)
    coarse = sift(np.asarray(cv2.resize(fine, halved, interpolation=cv2.INTER_AREA), np.uint8))
    return np.concatenate([_pooled(torch.from_numpy(sift(fine))), coarse, _pooled(torch.from_numpy(colour))], axis=-1)


def _pooled(image: Float[Tensor, "h w channel"]) -> Float[Tensor, "row column channel"]:
    """Means of squares of 2 x 2."""
    return (image[::2, ::2] + image[1::2, ::2] + image[::2, 1::2] + image[1::2, 1::2]) / 4


def _nearest(
    cells: Float[Tensor, "row column channel"], others: Float[Tensor, "row column channel"]
) -> tuple[Int[Tensor, " cell"], Int[Tensor, " other"]]:
    """The most similar of `others` for each cell, and the most similar cell for each of them.

    In blocks of products that stay in the processor's cache; of equals the first.
    """
    all_others = others.flatten(0, 1).T
    of_cells, of_others = [], np.zeros(all_others.shape[1], np.int64)
    highest = np.full(len(of_others), -np.inf, np.float32)
    for number, block in enumerate(cells.flatten(0, 1).split(BLOCK)):
        similarity = (block @ all_others).numpy()
        of_cells.append(similarity.argmax(1))
        top = similarity.max(0)  # argmax() along this axis takes many times as long
        risen = np.flatnonzero(top > highest)
        of_others[risen] = number * BLOCK + (similarity[:, risen] == top[risen]).argmax(0)
        highest[risen] = top[risen]
    return torch.from_numpy(np.concatenate(of_cells)), torch.from_numpy(of_others)


def _refined(
    cells: Float[Tensor, "row column channel"],
    other: Float[Tensor, "h w channel"],
    best: Int[Tensor, " cell"],
    which: Bool[Tensor, " cell"],
) -> Float[Tensor, "row column 2"]:
    """Displacements in cells to each cell's `best` cell; of those asked for with `which` to the most similar descriptor
    near it, refined by a parabola."""
    rows, columns, channels = cells.shape
    height, width = other.shape[:2]
    side = 2 * REACH + CELL
    own = torch.arange(rows * columns)
    moved = torch.stack([best % columns - own % columns, best // columns - own // columns], dim=-1).float()
    own, best = own[which], best[which]
    corner_y, corner_x = best // columns * CELL, best % columns * CELL
    offset = torch.arange(-REACH, REACH + CELL)
    y = (corner_y[:, None] + offset).clamp(0, height - 1)[:, :, None].expand(-1, side, side)
    x = (corner_x[:, None] + offset).clamp(0, width - 1)[:, None, :].expand(-1, side, side)
    near = other.flatten(0, 1).index_select(0, (y * width + x).flatten()).reshape(-1, side * side, channels)
    similarity = torch.einsum("pc,poc->po", cells.flatten(0, 1)[which], near)
    top = similarity.argmax(1)
    row, column = top // side, top % side
    grid = similarity.reshape(-1, side, side)
    each = torch.arange(len(top))
    found_x = x[each, row, column] + _peak(grid[each, row], column)
    found_y = y[each, row, column] + _peak(grid[each, :, column], row)
    middle = (CELL - 1) / 2
    away = torch.stack([found_x - own % columns * CELL - middle, found_y - own // columns * CELL - middle], dim=-1)
    moved[which] = away / CELL
    return moved.reshape(rows, columns, 2)


def _peak(values: Float[Tensor, "cell sample"], top: Int[Tensor, " cell"]) -> Float[Tensor, " cell"]:
    """How far beside its largest sample `top` a parabola through three samples peaks; 0 at the border."""
    last = values.shape[1] - 1
    each = torch.arange(len(top))
    before, at, after = values[each, (top - 1).clamp(0)], values[each, top], values[each, (top + 1).clamp(max=last)]
    bend = before - 2 * at + after
    inside = (top > 0) & (top < last) & (bend < -1e-5)
    return torch.where(inside, (0.5 * (before - after) / bend.clamp(max=-1e-5)).clamp(-0.5, 0.5), 0.0)


def _returns(there: Int[Tensor, " cell"], back: Int[Tensor, " other"], width: int) -> Bool[Tensor, " cell"]:
    """Whether the best match's best match is the cell itself or next to it. All frames have `width` columns."""
    returned = back[there]
    own = torch.arange(len(there))
    away = torch.stack([returned % width - own % width, returned // width - own // width], dim=-1)
    return away.float().norm(dim=-1) <= MUTUAL_CELLS


def supporters(displacement: Float[Tensor, "h w 2"], mutual: Bool[Tensor, "h w"]) -> Int[Tensor, "h w"]:
    """How many of the cells around each, itself not counted, have a mutual match that moved likewise."""
    height, width = mutual.shape
    reach = NEIGHBOURHOOD
    moved = displacement.permute(2, 0, 1).contiguous()
    padded = F.pad(moved, [reach] * 4)
    also = F.pad(mutual, [reach] * 4)
    count = torch.zeros(height, width, dtype=torch.int64)
    for down in range(2 * reach + 1):
        for right in range(2 * reach + 1):
            if (down, right) != (reach, reach):
                away = padded[:, down : down + height, right : right + width] - moved
                alike = torch.hypot(away[0], away[1]) < LIKEWISE_CELLS
                count += alike & also[down : down + height, right : right + width]
    return count

"""A sheet of pictures of the supervision: what the fit will learn from, for some frames of the clip."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from decomotion import images
from decomotion.clip import Clip
from decomotion.data.features.reduction import fit_reduction
from decomotion.data.pool import UNKNOWN_MOTION, Pool
from decomotion.files import replacing

ROWS = 5
"""Frames that are shown, spread over the clip."""
COLUMNS = ("frame and mask", "flow to the next shown", "confidence there", "linked frames", "features")
TILE = 320
"""Longer side of a picture in pixels."""
MARGIN, LINE = 8, 22
MASK_COLOUR = np.array([255, 60, 60])
UNKNOWN_COLOUR = 128
"""Grey, where there is no link; white is no motion."""

Image = npt.NDArray[np.uint8]


def write_sheet(clip: Clip, pool: Pool, grid: tuple[int, int], path: Path) -> None:
    """Writes the sheet as a PNG; `grid` are rows and columns of the pool's jittered points."""
    with replacing(path) as file:
        file.write_bytes(images.png(sheet(clip, pool, grid)))


def sheet(clip: Clip, pool: Pool, grid: tuple[int, int]) -> Image:
    """[h, w, 3]: a row for each shown frame, a column for each of `COLUMNS`."""
    shown = [int(frame) for frame in np.unique(np.linspace(0, len(clip) - 1, min(ROWS, len(clip))).round())]
    count = grid[0] * grid[1]
    flows = [_displacement(pool, frame, _other(shown, frame), count) for frame in shown]
    colours = flow_colours(np.stack(flows))
    for number, frame in enumerate(shown):
        colours[number, pool.confidence[frame, _other(shown, frame), :count] == 0] = UNKNOWN_COLOUR
    features = _feature_colours(pool, shown, count)
    rows = []
    for number, frame in enumerate(shown):
        other = _other(shown, frame)
        linked = (pool.confidence[frame, :, :count] > 0).mean(axis=0)
        rows.append(
            [
                _tile(_with_mask(clip.frames[frame], pool, frame, grid), clip, f"frame {frame}"),
                _tile(_on_grid(colours[number], grid), clip, f"to frame {other}"),
                _tile(_heat(pool.confidence[frame, other, :count] / 255, grid), clip, f"in frame {other}"),
                _tile(_heat(linked, grid), clip, f"{linked.mean():.0%} in the mean"),
                _tile(_on_grid(features[number], grid), clip, f"{pool.feature_size} channels"),
            ]
        )
    width = rows[0][0].shape[1]
    header = [_label(np.full((LINE, width, 3), 255, np.uint8), name) for name in COLUMNS]
    return np.concatenate([_joined(each) for each in (header, *rows)], axis=0)


def _other(shown: list[int], frame: int) -> int:
    """The next shown frame; for the last, the one before."""
    place = shown.index(frame)
    return shown[place + 1 if place + 1 < len(shown) else place - 1]


def _displacement(pool: Pool, frame: int, other: int, count: int) -> npt.NDArray[np.float32]:
    """[point, 2]; 0 where the target is not known."""
    moved = pool.targets[frame, other] - pool.points[frame]
    return np.where((pool.confidence[frame, other] > 0)[:, None], moved, 0)[:count].astype(np.float32)


def flow_colours(flow: npt.NDArray[np.float32]) -> npt.NDArray[np.uint8]:
    """RGB [row, point, 3] of displacements [row, point, 2]: the hue is their direction, and white those of length 0.

    The longest of all has a colour's full strength.
    """
    length, degrees = cv2.cartToPolar(flow[..., 0], flow[..., 1], angleInDegrees=True)
    strength = length / max(float(length.max()), 1e-6)
    hsv = np.stack([degrees, strength, np.ones_like(strength)], axis=-1).astype(np.float32)
    colours = np.asarray(cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB))
    return np.round(255 * colours).astype(np.uint8)


def _feature_colours(pool: Pool, shown: list[int], count: int) -> npt.NDArray[np.uint8]:
    """[shown frame, point, 3]: the first three principal directions of the shown features, as RGB."""
    features = np.stack([pool.feature[frame, :count] for frame in shown]).astype(np.float32)
    if features.shape[-1] < 3:
        return np.zeros((*features.shape[:2], 3), np.uint8)
    reduction = fit_reduction(features, 3)
    directions = features if reduction.vectors is None else (features - reduction.mean) @ reduction.vectors
    low, high = np.percentile(directions, (2, 98), axis=(0, 1))
    return (255 * np.clip((directions - low) / np.maximum(high - low, 1e-6), 0, 1)).astype(np.uint8)


def _with_mask(image: Image, pool: Pool, frame: int, grid: tuple[int, int]) -> Image:
    moving = pool.moving[frame, : grid[0] * grid[1]]
    if (moving == UNKNOWN_MOTION).all():
        return image
    size = (image.shape[1], image.shape[0])
    mask = cv2.resize((moving == 1).astype(np.uint8).reshape(grid), size, interpolation=cv2.INTER_NEAREST) > 0
    tinted = image.copy()
    tinted[mask] = (0.5 * image[mask] + 0.5 * MASK_COLOUR).astype(np.uint8)
    return tinted


def _heat(values: npt.NDArray[np.floating], grid: tuple[int, int]) -> Image:
    grey = np.round(255 * values).astype(np.uint8).reshape(grid)
    return np.asarray(cv2.cvtColor(cv2.applyColorMap(grey, cv2.COLORMAP_VIRIDIS), cv2.COLOR_BGR2RGB), np.uint8)


def _on_grid(values: npt.NDArray[np.uint8], grid: tuple[int, int]) -> Image:
    return values.reshape(*grid, 3)


def _tile(image: Image, clip: Clip, text: str) -> Image:
    scale = TILE / max(clip.height, clip.width)
    size = (round(clip.width * scale), round(clip.height * scale))
    interpolation = cv2.INTER_AREA if image.shape[1] > size[0] else cv2.INTER_NEAREST
    tile = np.asarray(cv2.resize(image, size, interpolation=interpolation), np.uint8)
    return np.concatenate([tile, _label(np.full((LINE, size[0], 3), 255, np.uint8), text)], axis=0)


def _label(strip: Image, text: str) -> Image:
    cv2.putText(strip, text, (2, LINE - 7), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (0, 0, 0), 1, cv2.LINE_AA)
    return strip


def _joined(tiles: list[Image]) -> Image:
    gap = np.full((tiles[0].shape[0], MARGIN, 3), 255, np.uint8)
    return np.concatenate([part for tile in tiles for part in (gap, tile)] + [gap], axis=1)

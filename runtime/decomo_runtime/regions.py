"""Query points in a region of a frame, given on the command line as a mask, a polygon or a box: rows of (t, x, y).

A region is a mask [H, W] of whole pixels, whatever it is given as. What lies beyond the frame's borders is left out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from decomo_runtime.errors import QueryError
from decomo_runtime.model_file import ModelFacts
from decomo_runtime.queries import grid_queries
from decomotion.frame_files import decode_mask

SPACING = 8.0
"""Pixels between points where nothing else is asked for."""
MOST = 2**20
"""Pixels; no corner of a polygon or box is farther from the frame."""
_BITS = 4
"""Of a pixel's fraction, as OpenCV draws polygons."""

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Region:
    """Of one frame."""

    mask: Mask
    """[H, W], True somewhere."""
    frame: int


def mask_region(text: str, model: ModelFacts) -> Region:
    """`"PNG@T"`: where the image is not black. `QueryError` where there is none, as of the others."""
    name, frame = _parted("--mask", text, "PNG@T: an image of the clip's size and a frame, such as dog.png@0", model)
    path = Path(name)
    try:
        mask = decode_mask(path.read_bytes(), path.suffix)
    except OSError as error:
        raise QueryError(
            f"--mask {path} cannot be read ({error.strerror}); give an image of the clip's size"
        ) from error
    if mask is None:
        raise QueryError(f"--mask {path} does not decode as an image; give a PNG of the clip's size")
    if mask.shape != (model.height, model.width):
        raise QueryError(
            f"--mask {path} is {mask.shape[1]}x{mask.shape[0]} but the clip is {model.width}x{model.height}; resize it"
        )
    if not mask.any():
        raise QueryError(f"--mask {path} is black: no pixel of it is the object's")
    return Region(mask, frame)


def polygon_region(text: str, model: ModelFacts) -> Region:
    """`"X,Y,X,Y,X,Y@T"`: a polygon."""
    form = "X,Y,X,Y,X,Y@T: three corners or more and a frame, such as 10,10,90,12,50,70@0"
    corners, frame = _parted("--polygon", text, form, model)
    numbers = _numbers(corners)
    if len(numbers) < 6 or len(numbers) % 2:
        raise QueryError(f"--polygon {text} is not {form}")
    canvas = np.zeros((model.height, model.width), np.uint8)
    whole = np.rint(np.reshape(numbers, (-1, 2)) * 2**_BITS).astype(np.int32)
    cv2.fillPoly(canvas, [whole], (1,), shift=_BITS)
    return _of_shape("--polygon", text, canvas > 0, frame)


def box_region(text: str, model: ModelFacts, option: str = "--box") -> Region:
    """`"X,Y,WIDTH,HEIGHT@T"`, given as `option`, X and Y of its first column and row."""
    form = "X,Y,WIDTH,HEIGHT@T: the upper left corner, a size above 0 and a frame, such as 40,20,100,60@0"
    place, frame = _parted(option, text, form, model)
    numbers = _numbers(place)
    if len(numbers) != 4 or not min(numbers[2:]) > 0:
        raise QueryError(f"{option} {text} is not {form}")
    corner, sides = np.reshape(numbers, (2, 2))
    mask = box_mask(np.stack([corner, corner + sides]) - 0.5, (model.height, model.width))
    return _of_shape(option, text, mask, frame)


def box_mask(corners: npt.NDArray[np.float64], size: tuple[int, int]) -> Mask:
    """[H, W] of `size`, the pixels whose centres lie in a box [2, 2], its upper left and its lower right corner."""
    x, y = np.arange(size[1]), np.arange(size[0])[:, None]
    (left, top), (right, bottom) = corners
    return (x >= left) & (x < right) & (y >= top) & (y < bottom)


REGIONS: dict[str, Callable[[str, ModelFacts], Region]] = {
    "--mask": mask_region,
    "--polygon": polygon_region,
    "--box": box_region,
}
"""By their options."""


def queries_in(option: str, text: str, spacing: float | None, model: ModelFacts) -> npt.NDArray[np.float64]:
    """[N, 3] rows of (t, x, y): points in the region that one of `REGIONS` says, as `region_queries`."""
    region = REGIONS[option](text, model)
    return region_queries(region.mask, region.frame, spacing)


def region_queries(mask: Mask, frame: int, spacing: float | None = None) -> npt.NDArray[np.float64]:
    """[N, 3] rows of (t, x, y): points every `spacing` pixels (default: `SPACING`) where `mask` [H, W] is True.

    The grid lies in the middle of what is True. Where none of its points is True, the pixel farthest from the rim is
    taken. `QueryError` where the spacing is below 1, or nothing is True.
    """
    if not mask.any():
        raise QueryError("the region has no pixel; give a mask that is True somewhere")
    spacing = SPACING if spacing is None else spacing
    if not 1 <= spacing < np.inf:
        raise QueryError(f"--spacing {spacing:g} must be at least 1 pixel")
    left, top, width, height = cv2.boundingRect(mask.astype(np.uint8))
    grid = grid_queries(spacing, frame, height, width) + np.array([0, left, top])
    queries = grid.astype(np.float32).astype(np.float64)  # as models are asked: rounding changes no pixel any more
    column, row = np.floor(queries[:, 1:] + 0.5).astype(np.int64).T
    inside = queries[mask[row, column]]
    if len(inside):
        return inside
    depth = cv2.distanceTransform(np.pad(mask, 1).astype(np.uint8), cv2.DIST_L2, 5)[1:-1, 1:-1]
    row, column = np.unravel_index(int(depth.argmax()), mask.shape)
    return np.array([[frame, column, row]], np.float64)


def _of_shape(option: str, text: str, mask: Mask, frame: int) -> Region:
    if not mask.any():
        height, width = mask.shape
        raise QueryError(
            f"{option} {text} lies outside of the frame, or between its pixels; the clip is {width}x{height}"
        )
    return Region(mask, frame)


def _parted(option: str, text: str, form: str, model: ModelFacts) -> tuple[str, int]:
    """What is before the last @, and the frame behind it."""
    before, at, behind = text.rpartition("@")
    if not at or not before or not behind.isdecimal():
        raise QueryError(f"{option} {text} is not {form}")
    frame = int(behind)
    if frame >= model.num_frames:
        raise QueryError(f"{option} {text}: the frame must be within 0 .. {model.num_frames - 1}, the clip's frames")
    return before, frame


def _numbers(text: str) -> Sequence[float]:
    """None of them where one is no number, or too far from any frame."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        return []
    return numbers if all(abs(number) < MOST for number in numbers) else []

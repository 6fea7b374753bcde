"""What a flow estimator is, and the rasters that flow lives on (`docs/conventions.md`)."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import cv2
import numpy as np
import numpy.typing as npt

Frame = npt.NDArray[np.uint8]
Flow = npt.NDArray[np.float32]
Size = tuple[int, int]
"""Width and height in pixels, as OpenCV orders them."""


@runtime_checkable
class FlowEstimator(Protocol):
    """Anything that says where the pixels of one frame lie in another."""

    concurrent: bool
    """Whether several threads may call it at once and gain by it; else it keeps all cores busy by itself."""

    guided: bool
    """Whether it searches from a start where it is given one, and is worth asking from there, too."""
    field_side: int
    """Longer side in pixels that its fields have at most."""

    def __call__(self, first: Frame, second: Frame, pair: tuple[int, int], start: Flow | None = None) -> Flow:
        """Flow from `first` to `second`, both [H, W, 3] RGB; `pair` are their numbers in the clip.

        `start` is about where pixels lie, on the field's raster; an estimator that is not `guided` ignores it.

        Returns float32 [h, w, 2]: the displacement (x, y) in pixels of the field's own raster, which covers the
        same image and may be coarser than the frames'.
        """
        ...

    def effort(self, gap: int) -> float:
        """What a search between frames so far apart takes, as a share of what one between neighbours takes."""
        ...

    def require(self, pairs: list[tuple[int, int]]) -> None:
        """Raises `SupervisionError` where one of these pairs cannot be answered, before any long work."""
        ...


def enlarged(height: int, width: int, factor: float, max_side: int, min_side: int = 1) -> Size:
    """Size of a frame enlarged by `factor`, its longer side at most `max_side`, its shorter at least `min_side`."""
    scale = max(min(factor, max_side / max(height, width)), min_side / min(height, width))
    return max(min_side, round(width * scale)), max(min_side, round(height * scale))


def resized(frame: npt.NDArray[np.uint8], size: Size) -> npt.NDArray[np.uint8]:
    """A frame [H, W] or [H, W, 3] brought to `size`; where it shrinks, pixels are averaged against aliasing."""
    how = cv2.INTER_AREA if size[0] < frame.shape[1] else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(frame, size, interpolation=how), np.uint8)


def kept(height: int, width: int, field_side: int) -> Size:
    """Size of the raster on which a frame's fields are kept: the frame's own, its longer side at most `field_side`."""
    return enlarged(height, width, 1.0, field_side)


def to_raster(flow: Flow, size: Size) -> Flow:
    """A flow brought to another raster of the same image: each axis has its own factor."""
    height, width = flow.shape[:2]
    if size == (width, height):
        return flow.astype(np.float32)
    smaller = size[0] <= width and size[1] <= height
    resized = cv2.resize(flow, size, interpolation=cv2.INTER_AREA if smaller else cv2.INTER_LINEAR)
    return resized * np.array([size[0] / width, size[1] / height], np.float32)

"""Optical flow between two frames, behind one small interface."""

from __future__ import annotations

from typing import Protocol

import cv2
import numpy as np
import numpy.typing as npt

from decomotion.config import FlowConfig

Frame = npt.NDArray[np.uint8]
Field = npt.NDArray[np.float32]


class FlowEstimator(Protocol):
    """Anything that says where the pixels of one frame lie in another."""

    def __call__(self, first: Frame, second: Frame) -> Field:
        """Flow from `first` to `second`, both [H, W, 3] RGB.

        Returns float32 [h, w, 2]: the displacement (x, y) in pixels of the field's own raster, which covers the
        same image and may be coarser than the frames'.
        """
        ...


class DisFlow:
    """OpenCV's Dense Inverse Search, run on enlarged frames down to its finest scale.

    DIS's presets stop at half resolution and lose what moves by less than a pixel; enlarging the frames and
    refining at scale 0 more than halves its error for seventeen times the cost. Not thread-safe: one object a thread.
    """

    def __init__(self, config: FlowConfig) -> None:
        self._config = config
        dis = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
        dis.setFinestScale(0)
        dis.setPatchStride(config.patch_stride)
        dis.setGradientDescentIterations(config.descent_iterations)
        dis.setVariationalRefinementIterations(config.refinement_iterations)
        self._dis = dis

    def __call__(self, first: Frame, second: Frame) -> Field:
        """See `FlowEstimator`; the field's raster is that of the frames, limited to `field_side`."""
        height, width = first.shape[:2]
        enlarge = min(self._config.upsample, self._config.max_side / max(height, width))
        size = (round(width * enlarge), round(height * enlarge))
        flow = self._dis.calc(_grey(first, size), _grey(second, size), None)  # type: ignore[call-overload]
        shrink = min(1.0, self._config.field_side / max(height, width))
        field = cv2.resize(flow, (round(width * shrink), round(height * shrink)), interpolation=cv2.INTER_AREA)
        return (field * (field.shape[1] / size[0])).astype(np.float32)


def _grey(frame: Frame, size: tuple[int, int]) -> npt.NDArray[np.uint8]:
    return cv2.resize(cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY), size, interpolation=cv2.INTER_CUBIC).astype(np.uint8)

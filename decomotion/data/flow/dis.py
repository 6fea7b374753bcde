"""OpenCV's Dense Inverse Search (Kroeger et al. 2016): no weights, fast on CPUs."""

from __future__ import annotations

import threading

import cv2
import numpy as np
import numpy.typing as npt

from decomotion.data.flow.config import DisFlowConfig
from decomotion.data.flow.interface import Flow, Frame, Size, enlarged, kept, resized, to_raster

MIN_SIDE = 12
"""OpenCV has no level of its pyramid for smaller frames."""


class DisFlow:
    """DIS, run on enlarged frames down to its finest scale; see `FlowEstimator`.

    DIS's presets stop at half resolution and lose what moves by less than a pixel; enlarging the frames and
    refining at scale 0 more than halves its error for seventeen times the cost.
    """

    concurrent = True

    def __init__(self, config: DisFlowConfig) -> None:
        self._config = config
        self.guided, self.field_side = config.guided, config.field_side
        # OpenCV's object keeps buffers, a start among them even for calls without: one of either kind a thread
        self._of_thread = threading.local()

    def __call__(
        self,
        first: Frame,
        second: Frame,
        pair: tuple[int, int] = (0, 1),
        start: Flow | None = None,
    ) -> Flow:
        """See `FlowEstimator`; the field's raster is that of the frames, limited to `field_side`."""
        height, width = first.shape[:2]
        part = self._reduced(abs(pair[1] - pair[0]))
        size = enlarged(height, width, self._config.upsample / part, self._config.max_side // part, MIN_SIDE)
        begin = None if start is None else np.ascontiguousarray(to_raster(start, size))
        flow = self._dis(guided=start is not None).calc(_grey(first, size), _grey(second, size), begin)  # type: ignore[call-overload]
        return to_raster(np.asarray(flow, np.float32), kept(height, width, self._config.field_side))

    def effort(self, gap: int) -> float:
        """By the pixels that are searched."""
        return 1 / self._reduced(gap) ** 2

    def _reduced(self, gap: int) -> int:
        return 2 if gap >= self._config.coarse_from else 1

    def require(self, pairs: list[tuple[int, int]]) -> None:
        """It answers any pair."""

    def _dis(self, guided: bool) -> cv2.DISOpticalFlow:
        name = "guided" if guided else "plain"
        if not hasattr(self._of_thread, name):
            dis = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
            dis.setFinestScale(0)
            dis.setPatchStride(self._config.patch_stride)
            dis.setGradientDescentIterations(self._config.descent_iterations)
            dis.setVariationalRefinementIterations(self._config.refinement_iterations)
            dis.setVariationalRefinementGamma(self._config.gradient_weight)
            setattr(self._of_thread, name, dis)
        return getattr(self._of_thread, name)


def _grey(frame: Frame, size: Size) -> npt.NDArray[np.uint8]:
    return resized(np.asarray(cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY), np.uint8), size)

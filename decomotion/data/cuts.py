"""Where a clip cuts from one shot to another: no motion leads across, and a fit across fails in silence."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
from scenedetect import FrameTimecode
from scenedetect.detectors import AdaptiveDetector

SIDE = 256
"""Frames are compared with this longer side."""
RATIO = 1.8
"""A cut changes a frame by so many times the average change of its neighbours."""
LEAST_CHANGE = 22.0
"""And by at least this much: mean difference of hue, saturation and brightness, 0 to 255."""
WINDOW = 2
"""Frames on either side that count as neighbours."""
FPS = 24.0
"""Any: detection counts frames."""


def find_cuts(frames: npt.NDArray[np.uint8]) -> list[int]:
    """The first frame of each shot but the first, ascending; `frames` are [T, H, W, 3] RGB.

    PySceneDetect's adaptive detector, which compares each change with the changes around it: pans and fast motion
    change every frame, a cut changes one. The clip is mirrored at its ends, so that cuts near them are found.
    """
    if len(frames) < 2:
        return []
    detector = AdaptiveDetector(
        adaptive_threshold=RATIO, min_content_val=LEAST_CHANGE, window_width=WINDOW, min_scene_len=0
    )
    padding = min(WINDOW + 1, len(frames) - 1)
    order = np.pad(np.arange(len(frames)), padding, mode="reflect")
    found = []
    for number, frame in enumerate(order):
        found += detector.process_frame(FrameTimecode(number, FPS), _small(frames[frame]))
    cuts = (cut.frame_num - padding for cut in found)
    return [frame for frame in cuts if 0 < frame < len(frames)]


def _small(frame: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """The frame reduced, in OpenCV's BGR, which PySceneDetect expects."""
    scale = min(1.0, SIDE / max(frame.shape[:2]))
    size = (max(1, round(frame.shape[1] * scale)), max(1, round(frame.shape[0] * scale)))
    return np.asarray(cv2.cvtColor(cv2.resize(frame, size, interpolation=cv2.INTER_AREA), cv2.COLOR_RGB2BGR), np.uint8)

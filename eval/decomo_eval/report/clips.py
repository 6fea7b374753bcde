"""The clips in which a tracker does worst, drawn: where points are, where it says they are."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from decomo_eval.scoring import Scored
from decomo_eval.tapvid import RASTER_SIZE
from decomo_runtime.overlay import contact_sheet
from decomotion.images import jpeg

Image = npt.NDArray[np.uint8]

CLIPS, FRAMES, POINTS = 3, 4, 60
"""How many clips are kept, frames of each drawn, and points in a frame at most."""
LONG_SIDE, JPEG_QUALITY = 320, 85
"""Pixels of a drawn frame, and how well it is kept."""
NEAR = 8
"""Raster pixels up to which a visible point counts as found here."""

FOUND, LOST, FALSE, TRUTH = (60, 200, 90), (240, 60, 50), (230, 70, 230), (255, 255, 255)
"""RGB of a point found, one lost or too far off, one said to be visible that is hidden, and of the true place."""

_SHIFT = 4  # OpenCV draws at 1 / 16 of a pixel


@dataclass(frozen=True)
class DrawnClip:
    """A clip of the report."""

    name: str
    average_jaccard: float
    jpeg: bytes
    """`FRAMES` frames side by side."""


class WorstClips:
    """Keeps the clips of least average Jaccard, drawn as they are seen, so that no video has to stay in memory."""

    def __init__(self) -> None:
        self.clips: list[DrawnClip] = []
        """The worst first."""

    def see(self, scored: Scored) -> None:
        """Takes a video into account; one without a defined average Jaccard is passed over."""
        value = scored.metrics["average_jaccard"]
        full = len(self.clips) == CLIPS
        if math.isnan(value) or (full and value >= self.clips[-1].average_jaccard):
            return
        drawn = DrawnClip(scored.video.name, value, jpeg(draw(scored), JPEG_QUALITY))
        self.clips = sorted([*self.clips, drawn], key=lambda clip: clip.average_jaccard)[:CLIPS]


def draw(scored: Scored) -> Image:
    """Frames of the clip side by side, evenly spaced, RGB; each query's answer drawn but in its own frame.

    A white ring is the true place of a visible point, joined to a disc at the predicted one: green where that is
    found, red where it is farther off than `NEAR` or said to be hidden (hollow). A magenta disc is a point that the
    tracker sees and that is hidden.
    """
    video, queries, prediction = scored.video, scored.queries, scored.prediction
    scale = LONG_SIDE / max(video.width, video.height)
    size = max(1, round(video.width * scale)), max(1, round(video.height * scale))
    on_canvas = np.array(size) / RASTER_SIZE
    chosen = np.unique(np.linspace(0, len(queries.points) - 1, min(POINTS, len(queries.points))).astype(int))
    frames = video.frames()
    drawn = []
    for frame in np.unique(np.linspace(0, video.num_frames - 1, FRAMES).round().astype(int)):
        canvas = cv2.resize(frames[frame], size, interpolation=cv2.INTER_AREA).astype(np.uint8)
        for row in chosen[queries.points[chosen, 0] != frame]:
            true, said = queries.tracks[row, frame], prediction.tracks[row, frame]
            visible, seen = not queries.occluded[row, frame], not prediction.occluded[row, frame]
            _mark(canvas, true * on_canvas - 0.5, said * on_canvas - 0.5, visible, seen, math.dist(true, said) < NEAR)
        drawn.append(canvas)
    return contact_sheet(drawn, gap=4)


def _mark(
    canvas: Image, true: npt.NDArray[np.float64], said: npt.NDArray[np.float64], visible: bool, seen: bool, near: bool
) -> None:
    if not visible and not seen:
        return
    there = _fixed(said)
    if visible:
        colour = FOUND if near and seen else LOST
        cv2.line(canvas, _fixed(true), there, colour, 1, cv2.LINE_AA, _SHIFT)
        cv2.circle(canvas, _fixed(true), 3 << _SHIFT, TRUTH, 1, cv2.LINE_AA, _SHIFT)
    else:
        colour = FALSE
    cv2.circle(canvas, there, 2 << _SHIFT, colour, cv2.FILLED if seen else 1, cv2.LINE_AA, _SHIFT)


def _fixed(place: npt.NDArray[np.float64]) -> tuple[int, int]:
    x, y = np.clip(place, -4096, 4096) * (1 << _SHIFT)  # OpenCV's numbers would overflow beyond
    return round(x), round(y)

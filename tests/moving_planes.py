"""A textured ground under a turning, zooming camera, a box that crosses it, and a tracker that errs about both.

Positions are (x, y) in pixels, pixel centres at integers. A point of the ground is told by where it is in frame 0, one
of the box by its place in it, from the box's corner.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from decomo_runtime import ModelFacts, Tracks

FRAMES, HEIGHT, WIDTH = 7, 200, 760
BOX = np.array([110.0, 90.0])
"""(width, height)"""

Video = npt.NDArray[np.uint8]
Places = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Motion:
    """Per frame."""

    turn: float = 0.02
    """Radians about the frame's middle."""
    zoom: float = 1.01
    pan: tuple[float, float] = (-3.3, 1.7)
    box_start: tuple[float, float] = (200.0, 60.0)
    """Of its corner."""
    box_velocity: tuple[float, float] = (21.4, 2.6)

    def ground(self, frame: int) -> npt.NDArray[np.float64]:
        """[2, 3], from frame 0 to `frame`."""
        matrix = cv2.getRotationMatrix2D((WIDTH / 2, HEIGHT / 2), np.degrees(self.turn * frame), self.zoom**frame)
        matrix[:, 2] += np.array(self.pan) * frame
        return np.asarray(matrix, np.float64)

    def box(self, frame: int) -> npt.NDArray[np.float64]:
        """[2], where its corner is."""
        return np.array(self.box_start) + frame * np.array(self.box_velocity)


def texture(seed: int, grain: float = 1.6, height: int = HEIGHT, width: int = WIDTH) -> npt.NDArray[np.float32]:
    """Grey values [h, w, 3] of structures of about `grain` pixels and of four times as much."""
    noise = np.random.default_rng(seed).standard_normal((height, width)).astype(np.float32)
    layers = [cv2.GaussianBlur(noise, (0, 0), size) for size in (grain, 4 * grain)]
    grey = sum(28 * layer / layer.std() for layer in layers) + 128
    return np.repeat(np.asarray(grey, np.float32)[..., None], 3, axis=2)


def photographed(
    motion: Motion, ground: npt.NDArray[np.floating] | None = None, box: npt.NDArray[np.floating] | None = None
) -> Video:
    """Frames [T, H, W, 3]; beyond its edges the ground is mirrored."""
    ground = texture(1) if ground is None else ground
    box = texture(2, height=int(BOX[1]), width=int(BOX[0])) if box is None else box
    frames = []
    for frame in range(FRAMES):
        picture = cv2.warpAffine(
            ground, motion.ground(frame), (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT
        )
        shift = np.column_stack([np.eye(2), motion.box(frame)])
        alpha = cv2.warpAffine(np.ones_like(box), shift, (WIDTH, HEIGHT))
        over = cv2.warpAffine(box, shift, (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        frames.append(picture * (1 - alpha) + over * alpha)
    return np.rint(np.stack(frames)).clip(0, 255).astype(np.uint8)


class ErringTracker:
    """Answers as `decomo_runtime.Tracker` does.

    Args:
        motion: what is true.
        error: by which answers err, about, in pixels; nothing in the query's own frame.
        offset: by which they err besides, everywhere alike, to the right, for each frame from the query's.
    """

    num_frames, height, width = FRAMES, HEIGHT, WIDTH
    facts = ModelFacts("planes", FRAMES, HEIGHT, WIDTH, 24.0, "cpu", 0.5, 0.1)

    def __init__(self, motion: Motion, error: float = 0.0, offset: float = 0.0) -> None:
        self.motion, self.error, self.offset = motion, error, offset

    def track(self, queries: npt.ArrayLike, frames: npt.ArrayLike | None = None) -> Tracks:
        queries = np.asarray(queries, np.float32)
        assert (np.abs(queries[:, 1:] - np.array([WIDTH - 1, HEIGHT - 1]) / 2) <= np.array([WIDTH, HEIGHT]) / 2).all()
        columns = np.arange(FRAMES) if frames is None else np.asarray(frames, np.int64)
        xy, occluded = np.empty((len(queries), len(columns), 2)), np.ones((len(queries), len(columns)), bool)
        for row, (t, *place) in enumerate(queries.astype(np.float64)):
            on_box = self.on_box(np.array(place), int(t))
            for column, frame in enumerate(columns.tolist()):
                true = self._carried(np.array(place), on_box, int(t), frame)
                xy[row, column] = true + self._error(np.array(place), frame) - self._error(np.array(place), int(t))
                xy[row, column, 0] += self.offset * (frame - t)
                outside = ((true < -0.5) | (true > np.array([WIDTH, HEIGHT]) - 0.5)).any()
                occluded[row, column] = outside or (self.on_box(true, frame) and not on_box)
        scores = occluded.astype(np.float32)
        return Tracks(xy.astype(np.float32), occluded, scores, queries, columns, (HEIGHT, WIDTH))

    def on_object(self, queries: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        return np.array([self.on_box(xy, int(t)) for t, *xy in np.asarray(queries).tolist()], bool)

    def on_box(self, xy: npt.ArrayLike, frame: int) -> bool:
        inside = np.asarray(xy) - self.motion.box(frame)
        return bool(((inside >= 0) & (inside <= BOX - 1)).all())

    def _carried(self, xy: Places, on_box: bool, frame: int, other: int) -> Places:
        if on_box:
            return xy - self.motion.box(frame) + self.motion.box(other)
        first = cv2.invertAffineTransform(self.motion.ground(frame)) @ (*xy, 1)
        return np.asarray(self.motion.ground(other) @ (*first, 1))

    def _error(self, xy: Places, frame: int) -> Places:
        along = xy @ (0.004, 0.006) + 0.8 * frame
        return self.error / 2 * np.array([np.sin(along), np.cos(1.3 * along)])

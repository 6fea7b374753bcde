"""The clip as its stabilisation has it: each frame brought to where it holds still, without aliasing.

What a frame does not show of the still picture is left transparent, cut off, or filled from the frames nearest in time
that show the scene there, at the exposure of the frame itself.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import cv2
import numpy as np
import numpy.typing as npt

from decomo_runtime.dense import dense_flows
from decomo_runtime.dense_maps import DenseMap, identity, smoothed
from decomo_runtime.errors import RenderError
from decomo_runtime.footage import FramesByNumber, check_footage, others_of
from decomo_runtime.mipmaps import Mipmaps
from decomo_runtime.objects import Objects
from decomo_runtime.options import BORDERS, CROP, DENSE, FILL
from decomo_runtime.sampling import sampled
from decomo_runtime.scene_maps import SceneMaps, continued, distance_from_objects
from decomo_runtime.scene_motion import follow_scene
from decomo_runtime.stabilisation import OBJECT, SCENE, Stabilisation, box_of
from decomotion.images import filled

if TYPE_CHECKING:
    from decomo_runtime.tracker import Tracker

Image = npt.NDArray[np.uint8]
Floats = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]
Places = npt.NDArray[np.floating]

LEAST_KEPT = 0.2
"""Of the frame's sides, by a crop: what leaves less is refused."""
CROP_SIDE = 320
"""Pixels of the longer side of the raster on which it is sought."""
FEATHER = 3.0
"""Pixels of a frame whose longer side is 256, over which its border blends into what fills the picture."""
AGREED = 10.0
"""Such pixels within which a dense map of an object or a box may part from the transform."""


def draw_stabilised(
    tracker: Tracker, frames: FramesByNumber, stabilisation: Stabilisation, *, border: str = BORDERS[0]
) -> tuple[Stabilisation, Iterator[Image]]:
    """The frames of `stabilisation`, of the clip's size: uint8 [H, W, 4] RGBA, alpha not premultiplied; filled, or
    cropped, [H, W, 3] RGB.

    Args:
        tracker: the model.
        frames: the whole clip, each uint8 [H, W, 3] RGB.
        stabilisation: as `stabilise` found it.
        border: one of `BORDERS`.

    Returns what was done, the crop included, and the pictures. Raises `OverlayError` where `frames` are of another
    clip, `RenderError` where a crop would leave too little, or `border` is "fill" and the model holds nothing to be
    static.
    """
    check_footage(frames, tracker.facts)
    if border not in BORDERS:
        raise RenderError(f"there is no border {border!r}; choose from {', '.join(BORDERS)}")
    maps = maps_of(tracker, stabilisation)
    if border == CROP:
        left, top, scale = _largest_crop(maps, stabilisation)
        stabilisation, maps = stabilisation.cropped(left, top, scale), _Cropped(maps, left, top, scale)
    fill = _Fill(tracker, frames, maps) if border == FILL else None
    return stabilisation, _drawn(frames, stabilisation, maps, fill, opaque=border == CROP)


def _drawn(
    frames: FramesByNumber, stabilisation: Stabilisation, maps: Maps, fill: _Fill | None, opaque: bool
) -> Iterator[Image]:
    for frame in stabilisation.frames.tolist():
        places = maps.places(frame)
        picture = Mipmaps(_opaque(frames[frame]))
        there = DenseMap(places, np.ones(places.shape[:2], np.float32))
        read = picture.read(places.reshape(-1, 2), there.scale.ravel()).reshape(*places.shape[:2], 4)
        read[..., :3] = 255 * read[..., :3] / np.maximum(read[..., 3:], 1e-6)
        read[..., 3] *= 255
        if fill is not None:
            read = fill.filled(frame, places, read[..., :3])
        yield np.rint(read[..., :3] if opaque else read).clip(0, 255).astype(np.uint8)


class Maps:
    """Where each pixel of the still picture is in a frame, by its matrix."""

    def __init__(self, stabilisation: Stabilisation) -> None:
        self.size = stabilisation.size
        pairs = zip(stabilisation.frames.tolist(), stabilisation.matrices, strict=True)
        self._inverse = {frame: np.linalg.inv(matrix) for frame, matrix in pairs}

    def places(self, frame: int) -> Floats:
        """[H, W, 2]"""
        return self.at(frame, identity(*self.size).places)

    def at(self, frame: int, xy: Places) -> Floats:
        """Where places [..., 2] of the still picture are in a frame."""
        moved = cv2.perspectiveTransform(xy.reshape(1, -1, 2).astype(np.float64), self._inverse[frame])
        return moved.reshape(xy.shape).astype(np.float32)


class _DenseMaps(Maps):
    """The same, by the model's answers for the pixels of the frame of reference."""

    def __init__(self, tracker: Tracker, stabilisation: Stabilisation) -> None:
        super().__init__(stabilisation)
        self._tracker, self._still = tracker, stabilisation.still
        self._held: tuple[int, Floats] | None = None
        what, reference = self._still.what, self._still.frame
        self._scene = SceneMaps(tracker, follow_scene(tracker)) if what == SCENE else None
        if what == OBJECT:
            self._wanted = distance_from_objects(tracker, reference) <= 0
        elif what != SCENE:
            self._wanted = box_of(tracker, self._still)

    def places(self, frame: int) -> Floats:
        if self._held is None or self._held[0] != frame:
            self._held = frame, self._found(frame)
        return self._held[1]

    def at(self, frame: int, xy: Places) -> Floats:
        return sampled(self.places(frame), np.asarray(xy, np.float32))

    def _found(self, frame: int) -> Floats:
        reference, base = self._still.frame, super().at(frame, identity(*self.size).places)
        if frame == reference:
            return base
        dense = next(dense_flows(self._tracker, reference, [frame]))
        seen = smoothed(dense, self._tracker.occlusion_threshold)
        if self._scene is not None:
            return self._scene.between(reference, frame, seen).places
        return continued(base, seen, self._wanted, AGREED * max(self.size) / 256).places


def maps_of(tracker: Tracker, stabilisation: Stabilisation) -> Maps:
    """The maps by which pictures are drawn."""
    return _DenseMaps(tracker, stabilisation) if stabilisation.by == DENSE else Maps(stabilisation)


class _Cropped(Maps):
    """Other maps, of a part of the picture, enlarged."""

    def __init__(self, maps: Maps, left: float, top: float, scale: float) -> None:
        self.size, self._maps, self._corner, self._scale = maps.size, maps, np.array([left, top]), scale

    def at(self, frame: int, xy: Places) -> Floats:
        return self._maps.at(frame, (xy + 0.5) / self._scale + self._corner - 0.5)


class _Fill:
    """What other frames show beyond the borders of one."""

    def __init__(self, tracker: Tracker, frames: FramesByNumber, maps: Maps) -> None:
        self._motion, self._size = follow_scene(tracker), maps.size
        self._objects = Objects(tracker, frames, self._motion)
        self._frames = self._objects.frames

    def filled(self, frame: int, places: Floats, own: Floats) -> Floats:
        """[H, W, 3], 0 to 255: `own` where `places` [H, W, 2] lie in the frame, and what fills the rest."""
        self._frames.leave_behind(frame)
        height, width = self._size
        inside = np.minimum(places + 0.5, np.array([width, height]) - 0.5 - places).min(axis=-1)
        weight = (inside / (FEATHER * max(self._size) / 256)).clip(0, 1)[..., None]
        missing = np.flatnonzero(weight < 1)
        colours = np.full((height * width, 3), np.nan, np.float32)
        for other in others_of(frame, len(self._frames)):
            if len(missing) == 0:
                break
            if not self._motion.knows(frame, other):
                continue
            there = self._motion.carry(places.reshape(-1, 2)[missing], frame, other).astype(np.float32)
            shown = self._objects.in_sight(other, there)
            exposure = self._objects.exposure(frame, other) if shown.any() else None
            if exposure is not None:
                colours[missing[shown]] = sampled(self._frames[other], there[shown], cv2.INTER_CUBIC) + exposure
                missing = missing[~shown]
        around = colours.reshape(height, width, 3)
        unknown = np.isnan(around[..., 0])
        around = np.where(unknown[..., None], own, around)
        picture = np.where(inside[..., None] >= 0, weight * own + (1 - weight) * around, around)
        known = (~unknown | (inside >= 0)).astype(np.float32)
        return picture if known.all() else filled(picture.astype(np.float32), known)


def _largest_crop(maps: Maps, stabilisation: Stabilisation) -> tuple[float, float, float]:
    """(left, top, scale): the largest part of the clip's shape that all frames cover; `Stabilisation.cropped`."""
    height, width = maps.size
    step = max(1.0, max(height, width) / CROP_SIDE)
    rows, columns = math.ceil(height / step), math.ceil(width / step)
    x, y = np.arange(columns) * width / columns, np.arange(rows) * height / rows
    ends = [np.stack(np.meshgrid(x + dx, y + dy), axis=-1) for dx in (0, width / columns) for dy in (0, height / rows)]
    covered = np.ones((rows, columns), bool)
    for frame in stabilisation.frames.tolist():
        for corner in ends:
            places = maps.at(frame, corner - 0.5)
            covered &= ((places >= -0.5) & (places <= np.array([width, height]) - 0.5)).all(axis=-1)
    best = _largest_rectangle(covered)
    if best is None:
        raise RenderError(
            f"no part of the still picture, {LEAST_KEPT:.0%} of the frame's sides or more, is shown by all frames, so "
            "that there is nothing to crop it to; smooth the motion instead, fill the border, or take fewer frames"
        )
    row, column, share = best
    return column * width / columns, row * height / rows, 1 / share


def _largest_rectangle(covered: Mask) -> tuple[int, int, float] | None:
    """(row, column, share of the sides) of the largest rectangle of the raster's shape, nearest to the middle."""
    rows, columns = covered.shape
    total = cv2.integral(covered.astype(np.uint8))
    for size in range(max(rows, columns), 0, -1):
        share = size / max(rows, columns)
        if share < LEAST_KEPT:
            break
        high, wide = math.ceil(rows * share), math.ceil(columns * share)
        counts = total[high:, wide:] - total[:-high, wide:] - total[high:, :-wide] + total[:-high, :-wide]
        row, column = np.nonzero(counts == high * wide)
        if len(row):
            middle = np.argmin(np.hypot(row - (rows - high) / 2, column - (columns - wide) / 2))
            return int(row[middle]), int(column[middle]), share
    return None


def _opaque(frame: Image) -> Image:
    return np.dstack([frame, np.full(frame.shape[:2], 255, np.uint8)])

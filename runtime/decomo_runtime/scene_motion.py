"""How the static scene moves from frame to frame, also where an object hides it.

The model's tracks of points on the static scene tie any two frames together. A homography is fitted to the points that
both see; what it leaves over, parallax, is interpolated smoothly. Behind an object, where the static volume has never
been seen and its map is a guess, the motion therefore continues that of the scene around it.

Points are followed when they are first asked for, from the frames around the two: cost and memory of a pair of frames
do not depend on the length of the clip.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING

import cv2
import numpy as np
import numpy.typing as npt

from decomo_runtime.errors import RenderError
from decomo_runtime.queries import grid_queries
from decomo_runtime.raster import Raster, whole
from decomo_runtime.sampling import sampled
from decomotion.images import filled

if TYPE_CHECKING:
    from decomo_runtime.tracker import Tracker
    from decomo_runtime.tracks import Tracks

    Track = Callable[[npt.NDArray[np.floating], npt.NDArray[np.int64]], Tracks]

Floats = npt.NDArray[np.floating]

KEY_FRAMES, KEY_FRAME_GAP = 4, 12
"""Frames in which points of the scene are picked: at least so many, and at least one in so many frames."""
POINTS_ALONG = 24
"""Points along the longer side of a key frame."""
OBJECT_POINTS_ALONG = 64
"""As many, where objects are followed, which have a part of them."""
SPAN = 48
"""Two frames are tied by the points of key frames up to so many frames from either."""

_LEAST_POINTS = 12
"""Fewer common points do not tell the motion between two frames."""
_INLIER, _OUTLIER = 1.5, 6.0
"""Pixels of a frame whose longer side is 256: noise of a track about the homography; beyond the second it is wrong."""
_CELLS = 32
"""Cells along the longer side of the raster on which the remainder is interpolated."""
_NODES_A_CELL = 4
"""Places of a field that are carried, along the side of a cell; it is interpolated between them."""
_BLOCK = 16
"""Frames to which points are followed at once."""
_HELD_BLOCKS, _HELD_FITS = 512, 4096
"""Blocks of a key frame's points, and motions between two frames, that are held: 5 kB a motion, 50 kB a block."""


class SceneMotion:
    """Motion of the static scene between frames of a clip.

    Args:
        track: follows queries [N, 3] to frames [M], as `Tracker.track` does.
        points: queries [N, 3] on the static scene, all those of one key frame together.
        size: of the clip: frames, height and width.
    """

    def __init__(self, track: Track, points: Floats, size: tuple[int, int, int]) -> None:
        self._track, self._num_frames, self._size = track, size[0], size[1:]
        self._key_frames, first = np.unique(points[:, 0].astype(int), return_index=True)
        self._points = np.split(points, first[1:])
        self._unit = max(self._size) / 256
        self._cell = max(self._size) / _CELLS
        self._followed = lru_cache(_HELD_BLOCKS)(self._follow)
        self._fitted = lru_cache(_HELD_FITS)(self._fit)

    def knows(self, frame: int, other: int) -> bool:
        """Whether enough points are seen in both frames to tell the motion between them."""
        return frame == other or self._fitted(frame, other) is not None

    def carry(self, xy: npt.ArrayLike, frame: int, other: int) -> npt.NDArray[np.float64]:
        """Where places `xy` [..., 2] of `frame` lie in `other` if they move with the scene; nan if that is unknown.

        Pixels of the clip, inside or outside the image.
        """
        places = np.asarray(xy, np.float64).reshape(-1, 2)
        fitted = None if frame == other else self._fitted(frame, other)
        if frame != other:
            places = np.full_like(places, np.nan) if fitted is None else self._move(places, *fitted)
        return places.reshape(np.shape(xy))

    def field(self, frame: int, other: int, raster: Raster | None = None) -> npt.NDArray[np.float32]:
        """[h, w, 2]: where each pixel of a `raster` over `frame` lies in `other`, in pixels of such a raster there.

        By default the clip's own pixels. It is interpolated between every few pixels; otherwise as `carry`.
        """
        raster = whole(self._size) if raster is None else raster
        scale = np.array([self._size[1] / raster.size[1], self._size[0] / raster.size[0]])
        step = max(1, max(raster.size) // (_NODES_A_CELL * _CELLS))
        y, x = (
            np.arange(part.start - step, part.stop + step, step) + (step - 1) / 2
            for part in (raster.rows, raster.columns)
        )
        nodes = (np.stack(np.meshgrid(x, y), axis=-1) + 0.5) * scale - 0.5
        there = ((self.carry(nodes, frame, other) + 0.5) / scale - 0.5).astype(np.float32)
        fine = there if step == 1 else cv2.resize(there, None, fx=step, fy=step, interpolation=cv2.INTER_LINEAR)
        height, width = raster.shape
        return fine[step : step + height, step : step + width].astype(np.float32, copy=False)

    def _move(
        self, places: npt.NDArray[np.float64], homography: npt.NDArray[np.float64], remainder: Floats
    ) -> npt.NDArray[np.float64]:
        if len(places) == 0:
            return places
        cells = np.nan_to_num((places + 0.5) / self._cell - 0.5).clip(-1, 4 * _CELLS)
        moved = cv2.perspectiveTransform(places[None], homography)[0] + sampled(remainder, cells)
        moved[~np.isfinite(places).all(axis=1)] = np.nan  # OpenCV takes them to 0
        return moved

    def _follow(self, key: int, block: int) -> tuple[Floats, npt.NDArray[np.bool_]]:
        """The points of a key frame, [N, M, 2], and whether they are seen, [N, M], in a block of the clip's frames."""
        frames = np.arange(block * _BLOCK, min(self._num_frames, (block + 1) * _BLOCK))
        tracks = self._track(self._points[key], frames)
        return tracks.xy.astype(np.float32), ~tracks.occluded

    def common(self, *frames: int) -> npt.NDArray[np.float32]:
        """[2, N, 2]: where the points that are seen in two frames lie in each, of the key frames near to either."""
        near = np.abs(self._key_frames[:, None] - frames).min(axis=1) <= SPAN
        common = []
        for key in np.flatnonzero(near).tolist():
            blocks = [self._followed(key, frame // _BLOCK) for frame in frames]
            columns = [frame % _BLOCK for frame in frames]
            seen = np.logical_and(*(seen[:, column] for (_, seen), column in zip(blocks, columns, strict=True)))
            common.append([xy[seen, column] for (xy, _), column in zip(blocks, columns, strict=True)])
        return np.concatenate(common, axis=1) if common else np.empty((2, 0, 2), np.float32)

    def _fit(self, frame: int, other: int) -> tuple[npt.NDArray[np.float64], Floats] | None:
        """The homography from `frame` to `other`, and the remainder [rows, columns, 2] on the raster of cells."""
        here, there = self.common(frame, other)
        if len(here) < _LEAST_POINTS:
            return None
        homography, _ = cv2.findHomography(here, there, cv2.USAC_MAGSAC, _INLIER * self._unit)
        if homography is None:
            return None
        remainder = there - cv2.perspectiveTransform(here[None], homography)[0]
        kept = np.linalg.norm(remainder, axis=1) < _OUTLIER * self._unit
        if kept.sum() < _LEAST_POINTS:
            return None
        rows, columns = (int(np.ceil(side / self._cell)) for side in self._size)
        cell = ((here[kept] + 0.5) / self._cell).astype(int).clip(0, (columns - 1, rows - 1))
        total, count = np.zeros((rows, columns, 2), np.float32), np.zeros((rows, columns), np.float32)
        np.add.at(total, (cell[:, 1], cell[:, 0]), remainder[kept])
        np.add.at(count, (cell[:, 1], cell[:, 0]), 1)
        smooth = filled(total / np.maximum(count, 1)[..., None], np.minimum(count, 1))
        return np.asarray(homography, np.float64), cv2.GaussianBlur(smooth, (0, 0), 1).astype(np.float32)


def follow_scene(tracker: Tracker) -> SceneMotion:
    """The motion of the static scene of the tracker's clip.

    Raises `RenderError` where the model holds nothing to be static.
    """
    points = _grid_of_key_frames(tracker, POINTS_ALONG)
    points = points[~tracker.on_object(points)]
    if len(points) < _LEAST_POINTS:
        raise RenderError(
            f"{tracker.path} holds nothing in {tracker.clip_name} to be static, so that the scene's motion is unknown; "
            "fit it again, for longer or with masks of what moves"
        )
    return SceneMotion(tracker.track, points, (tracker.num_frames, tracker.height, tracker.width))


def follow_objects(tracker: Tracker) -> SceneMotion:
    """The motion of the moving objects of the tracker's clip, all taken for one.

    Raises `RenderError` where the model holds nothing to move.
    """
    points = _grid_of_key_frames(tracker, OBJECT_POINTS_ALONG)
    points = points[tracker.on_object(points)]
    if len(points) < _LEAST_POINTS:
        raise RenderError(f"{tracker.path} holds nothing in {tracker.clip_name} to move by itself")
    return SceneMotion(tracker.track, points, (tracker.num_frames, tracker.height, tracker.width))


def _grid_of_key_frames(tracker: Tracker, along: int) -> npt.NDArray[np.float64]:
    """Queries [N, 3], `along` of them along the longer side."""
    model = tracker.facts
    count = min(model.num_frames, max(KEY_FRAMES, -(-model.num_frames // KEY_FRAME_GAP)))
    key_frames = np.linspace(0, model.num_frames - 1, count).round().astype(int)
    step = max(1.0, max(model.height, model.width) / along)
    return np.concatenate([grid_queries(step, frame, model.height, model.width) for frame in key_frames])

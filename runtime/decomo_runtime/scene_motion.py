"""How the static scene moves from frame to frame, also where an object hides it.

The model's tracks of points on the static scene tie any two frames together. A homography is fitted to the points that
both see; what it leaves over, parallax, is interpolated smoothly. Behind an object, where the static volume has never
been seen and its map is a guess, the motion therefore continues that of the scene around it.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import cv2
import numpy as np
import numpy.typing as npt

from decomo_runtime.errors import RenderError
from decomo_runtime.queries import grid_queries
from decomotion.images import filled

if TYPE_CHECKING:
    from decomo_runtime.tracker import Tracker
    from decomo_runtime.tracks import Tracks

Floats = npt.NDArray[np.floating]

KEY_FRAMES, KEY_FRAME_GAP = 4, 12
"""Frames in which points of the scene are picked: at least so many, and at least one in so many frames."""
POINTS_ALONG = 24
"""Points along the longer side of a key frame."""

_LEAST_POINTS = 12
"""Fewer common points do not tell the motion between two frames."""
_INLIER, _OUTLIER = 1.5, 6.0
"""Pixels of a frame whose longer side is 256: noise of a track about the homography; beyond the second it is wrong."""
_CELLS = 32
"""Cells along the longer side of the raster on which the remainder is interpolated."""


class SceneMotion:
    """Motion of the static scene between frames of a clip.

    Args:
        tracks: of points on the static scene, to all frames of the clip in order.
        height: of the clip, pixels; so is `width`.
    """

    def __init__(self, tracks: Tracks, height: int, width: int) -> None:
        self._xy, self._seen = tracks.xy.astype(np.float32), ~tracks.occluded
        self._size = height, width
        self._unit = max(height, width) / 256
        self._cell = max(height, width) / _CELLS
        self._fitted = lru_cache(maxsize=4096)(self._fit)

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

    def field(self, frame: int, other: int) -> npt.NDArray[np.float32]:
        """[H, W, 2]: where each pixel of `frame` lies in `other`; as `carry`."""
        height, width = self._size
        grid = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1)
        return self.carry(grid, frame, other).astype(np.float32)

    def _move(
        self, places: npt.NDArray[np.float64], homography: npt.NDArray[np.float64], remainder: Floats
    ) -> npt.NDArray[np.float64]:
        if len(places) == 0:
            return places
        x, y = np.nan_to_num((places + 0.5) / self._cell - 0.5).clip(-1, 4 * _CELLS).astype(np.float32).T
        blocks = [  # cv2.remap takes no more rows than a short counts
            cv2.remap(remainder, x[rows, None], y[rows, None], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[:, 0]
            for rows in np.array_split(np.arange(len(places)), len(places) // 30_000 + 1)
        ]
        moved = cv2.perspectiveTransform(places[None], homography)[0] + np.concatenate(blocks)
        moved[~np.isfinite(places).all(axis=1)] = np.nan  # OpenCV takes them to 0
        return moved

    def _fit(self, frame: int, other: int) -> tuple[npt.NDArray[np.float64], Floats] | None:
        """The homography from `frame` to `other`, and the remainder [rows, columns, 2] on the raster of cells."""
        common = self._seen[:, frame] & self._seen[:, other]
        here, there = self._xy[common, frame], self._xy[common, other]
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
    model = tracker.facts
    count = min(model.num_frames, max(KEY_FRAMES, -(-model.num_frames // KEY_FRAME_GAP)))
    key_frames = np.linspace(0, model.num_frames - 1, count).round().astype(int)
    step = max(1.0, max(model.height, model.width) / POINTS_ALONG)
    points = np.concatenate([grid_queries(step, frame, model.height, model.width) for frame in key_frames])
    points = points[~tracker.on_object(points)]
    if len(points) < _LEAST_POINTS:
        raise RenderError(
            f"{tracker.path} holds nothing in {model.clip_name} to be static, so that the scene's motion is unknown; "
            "fit it again, for longer or with masks of what moves"
        )
    return SceneMotion(tracker.track(points), model.height, model.width)

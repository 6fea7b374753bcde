"""Transforms that hold the scene, an object or a box of a clip still.

The points of what is to be still that two frames both show tell the transform from one to the other. Without smoothing
each frame is brought to where its points are in the frame of reference; with it to where they are in the mean of the
frames around it, so that the slow motion stays and the fast one goes. A frame that shows too few of the points is taken
to move as those around it.

A matrix [3, 3] takes (x, y, 1), pixels of a frame, to pixels of the still picture, which has the clip's size.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
import numpy.typing as npt

from decomo_runtime.errors import RenderError
from decomo_runtime.formats.about import About
from decomo_runtime.formats.registry import TracksFormat, format_of
from decomo_runtime.options import DENSE, HOMOGRAPHY, SIMILARITY, TRANSFORMS, TRANSLATION
from decomo_runtime.queries import check_frames
from decomo_runtime.regions import box_region, region_queries
from decomo_runtime.scene_motion import SceneMotion, follow_objects, follow_scene
from decomo_runtime.tracks import Tracks
from decomotion.files import replacing

if TYPE_CHECKING:
    from decomo_runtime.model_file import ModelFacts
    from decomo_runtime.tracker import Tracker

Matrix = npt.NDArray[np.float64]

SCENE, OBJECT = "scene", "object"
NUKE_CORNER_PIN = "nuke-corner-pin"
CORNERS = ("upper_left", "upper_right", "lower_right", "lower_left")
BOX_POINTS = 400
"""Points in a box, about."""
REACH, ANCHORS = 3.0, 3
"""Of smoothing: frames are averaged up to so many deviations away, and so many of them for each deviation."""
_INLIER = 1.5
"""Pixels of a frame whose longer side is 256: noise of a track about the transform."""
_LEAST = {TRANSLATION: 2, SIMILARITY: 4, HOMOGRAPHY: 12}
"""Fewer points do not tell a transform."""
_MOST_STRETCH = 8.0
"""A transform that enlarges or shrinks the frame by more is a wrong one."""


@dataclass(frozen=True)
class Still:
    """What is to be still."""

    what: str
    """`SCENE`, `OBJECT`, or a box, `"X,Y,WIDTH,HEIGHT"`."""
    frame: int = 0
    """Of reference: the picture is as there, and a box lies there."""

    @classmethod
    def parse(cls, text: str) -> Still:
        """Of `"scene"`, `"object"` or `"X,Y,WIDTH,HEIGHT"`, each with `@T` behind or without; else `RenderError`."""
        what, at, frame = text.partition("@")
        if (at and not frame.isdecimal()) or (what not in (SCENE, OBJECT) and what.count(",") != 3):
            raise RenderError(
                f"--stabilise {text} is not {SCENE}, {OBJECT} or X,Y,WIDTH,HEIGHT, nor one of them with a frame of "
                f"reference, such as {OBJECT}@12"
            )
        return cls(what, int(frame or 0))


@dataclass(frozen=True, eq=False)
class Stabilisation:
    """What holds a clip still, frame by frame."""

    frames: npt.NDArray[np.int64]
    """[M], numbers in the clip."""
    matrices: Matrix
    """[M, 3, 3], from pixels of each frame to those of the still picture."""
    known: npt.NDArray[np.bool_]
    """[M], False where too few points are in sight, so that the frame is taken to move as those around it."""
    still: Still
    size: tuple[int, int]
    """(height, width) of the clip."""
    times: npt.NDArray[np.float64]
    """[M], seconds."""
    by: str = HOMOGRAPHY
    """One of `TRANSFORMS`."""

    def cropped(self, left: float, top: float, scale: float) -> Stabilisation:
        """Of a part of the still picture, enlarged: from (left, top) on, pixels from its corner, 1 / scale as large."""
        crop = np.array([[scale, 0, -scale * left + (scale - 1) / 2], [0, scale, -scale * top + (scale - 1) / 2]])
        return replace(self, matrices=np.vstack([crop, [0, 0, 1]]) @ self.matrices)

    def corners(self) -> Tracks:
        """Where the corners of each frame are in the still picture, clockwise from the upper left one."""
        corners = _corners(self.size)
        xy = np.stack([cv2.perspectiveTransform(corners[None], matrix)[0] for matrix in self.matrices], axis=1)
        hidden = np.zeros(xy.shape[:2], bool)
        queries = np.column_stack([np.full(4, self.frames[0]), corners])
        return Tracks(
            *(xy.astype(np.float32), hidden, hidden.astype(np.float32), queries.astype(np.float32), self.frames),
            self.size,
            self.times,
        )

    def save(self, path: Path, model: ModelFacts, clip: Path | None = None) -> None:
        """Writes `path`, whole or not at all, by its ending.

        A .csv has a line for each frame: its number, second, whether it is known, and its matrix row by row. A .nk has
        a CornerPin2D; others have `corners` in that format of tracks.
        `TracksFileError` where it means none; `model` and `clip` tell what some formats want to know beside.
        """
        form = format_of_transforms(path)
        if form is not None:
            form.write(self.corners(), path, replace(About.of(model, clip), points=CORNERS))
            return
        names = ",".join(f"h{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3))
        lines = [f"frame,seconds,known,{names}"]
        for frame, second, known, matrix in zip(self.frames, self.times, self.known, self.matrices, strict=True):
            lines.append(f"{frame},{second:.6f},{int(known)}," + ",".join(f"{value:.10g}" for value in matrix.ravel()))
        with replacing(path) as temporary:
            temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")


def format_of_transforms(path: Path) -> TracksFormat | None:
    """In which transforms are written there; None of a .csv, which is not of tracks. `TracksFileError` if in none."""
    if path.suffix.lower() == ".csv":
        return None
    return format_of(path, NUKE_CORNER_PIN if path.suffix.lower() == ".nk" else None)


def stabilise(
    tracker: Tracker,
    still: Still | str,
    *,
    by: str | None = None,
    smooth: float = 0.0,
    frames: npt.ArrayLike | None = None,
) -> Stabilisation:
    """The transforms that hold `still` still in `frames` [M] (default: all) of the tracker's clip.

    Args:
        tracker: the model.
        still: what, as `Still.parse` takes it.
        by: one of `TRANSFORMS`; default: a homography for the scene, a similarity for the rest. Of a dense one the
            transforms are those by which it goes on where its map is not known.
        smooth: seconds, the deviation of what the motion is averaged over; 0: no motion stays.

    Raises `RenderError` where there is no such thing in the clip, or it is never seen in another frame, or no frame is
    asked for, `QueryError` where a frame is none of the clip or a box lies outside of it.
    """
    still = Still.parse(still) if isinstance(still, str) else still
    by = by or (HOMOGRAPHY if still.what == SCENE else SIMILARITY)
    if by not in TRANSFORMS:
        raise RenderError(f"there is no transform {by!r}; choose from {', '.join(TRANSFORMS)}")
    if not 0 <= smooth < math.inf:
        raise RenderError(f"--smooth {smooth:g} must be a time of 0 seconds or more")
    if smooth and by == DENSE:
        raise RenderError(
            f"--by {DENSE} brings each frame to one frame of reference, and --smooth to the mean of several; "
            "leave one out"
        )
    if not 0 <= still.frame < tracker.num_frames:
        raise RenderError(
            f"the frame of reference, {still.frame}, must be within 0 .. {tracker.num_frames - 1}, the clip's frames"
        )
    wanted = check_frames(frames, tracker.num_frames)
    if not len(wanted):
        raise RenderError("there is no frame to hold still; give at least one")
    form = by if by in _LEAST else (HOMOGRAPHY if still.what == SCENE else SIMILARITY)
    motion = _motion(tracker, still)
    pairs = _Pairs(motion, form, (tracker.height, tracker.width))
    every = range(tracker.num_frames)
    found = _averaged(pairs, wanted, smooth * tracker.fps, every) if smooth else _held(pairs, still.frame, wanted)
    matrices, known = _completed(found, wanted, (tracker.height, tracker.width))
    if not known.any():
        raise RenderError(
            f"too few points of the {still.what} are in sight in frame {still.frame} and in any other; name another "
            f"frame of reference, such as {still.what}@{tracker.num_frames // 2}"
        )
    return Stabilisation(wanted, matrices, known, still, (tracker.height, tracker.width), tracker.times[wanted], by)


def _motion(tracker: Tracker, still: Still) -> SceneMotion:
    if still.what == SCENE:
        return follow_scene(tracker)
    if still.what == OBJECT:
        return follow_objects(tracker)
    box = box_of(tracker, still)
    points = region_queries(box, still.frame, max(1.0, math.sqrt(box.sum() / BOX_POINTS)))
    return SceneMotion(tracker.track, points, (tracker.num_frames, tracker.height, tracker.width))


def box_of(tracker: Tracker, still: Still) -> npt.NDArray[np.bool_]:
    """[H, W], the pixels of a box that is to be still."""
    return box_region(f"{still.what}@{still.frame}", tracker.facts, "--stabilise").mask


class _Pairs:
    """Transforms between two frames, of a `form`, by what both see of the moving points."""

    def __init__(self, motion: SceneMotion, form: str, size: tuple[int, int]) -> None:
        self._motion, self._form, self.size = motion, form, size
        self.between = lru_cache(4096)(self._fit)

    def _fit(self, frame: int, other: int) -> Matrix | None:
        """From `frame` to `other`; None where too few points tell it."""
        if frame == other:
            return np.eye(3)
        here, there = self._motion.common(frame, other)
        if len(here) < _LEAST[self._form]:
            return None
        matrix = _fitted(here.astype(np.float64), there.astype(np.float64), self._form, max(self.size) / 256)
        return matrix if matrix is not None and _is_sane(matrix, self.size) else None


def _fitted(here: npt.NDArray[np.float64], there: npt.NDArray[np.float64], form: str, unit: float) -> Matrix | None:
    if form == HOMOGRAPHY:
        matrix, _ = cv2.findHomography(here, there, cv2.USAC_MAGSAC, _INLIER * unit)
        return None if matrix is None else np.asarray(matrix, np.float64)
    if form == SIMILARITY:
        matrix, _ = cv2.estimateAffinePartial2D(here, there, method=cv2.RANSAC, ransacReprojThreshold=_INLIER * unit)
        return None if matrix is None else np.vstack([matrix, [0, 0, 1]])
    matrix = np.eye(3)
    matrix[:2, 2] = np.median(there - here, axis=0)
    return matrix


def _is_sane(matrix: Matrix, size: tuple[int, int]) -> bool:
    """Whether the frame is not turned over, cut at the horizon, or stretched beyond belief."""
    height, width = size
    corners = np.array([[0, 0, 1], [width, 0, 1], [width, height, 1], [0, height, 1]], np.float64)
    moved = corners @ matrix.T
    if not np.isfinite(moved).all() or (moved[:, 2] <= 0).any():
        return False
    area = cv2.contourArea((moved[:, :2] / moved[:, 2:]).astype(np.float32), oriented=True) / (height * width)
    return 1 / _MOST_STRETCH**2 < area < _MOST_STRETCH**2


def _held(pairs: _Pairs, reference: int, wanted: Iterable[int]) -> dict[int, Matrix]:
    """Each frame's transform to that of reference; where both see too little of the same, over the frames between."""
    found = {reference: np.eye(3)}
    numbers = [int(frame) for frame in wanted]
    for step in (1, -1):
        farthest = max((step * (frame - reference) for frame in numbers), default=0)
        last = reference  # that is known
        for frame in range(reference, reference + step * (farthest + 1), step):
            matrix = pairs.between(frame, reference)
            if matrix is None:
                onward = pairs.between(frame, last)
                matrix = None if onward is None else found[last] @ onward
            if matrix is not None and _is_sane(matrix, pairs.size):
                found[frame], last = matrix / matrix[2, 2], frame
    return found


def _averaged(pairs: _Pairs, wanted: Iterable[int], deviation: float, every: Sequence[int]) -> dict[int, Matrix]:
    """Each frame's transform to where its corners are in the weighted mean of the frames around it.

    These are the same for all, a fixed few of the clip's, so that the mean moves smoothly.
    """
    step = max(1, int(deviation / ANCHORS))
    anchors, reach = every[::step], math.ceil(REACH * deviation / step) + 1
    corners = _corners(pairs.size)
    found = {}
    for frame in map(int, wanted):
        weights, places, others = [], [], 0
        for anchor in anchors[max(0, frame // step - reach) : frame // step + reach + 1]:
            away = abs(anchor - frame) / deviation
            matrix = pairs.between(frame, anchor) if away <= REACH else None
            if matrix is not None:
                weights.append(math.exp(-(away**2) / 2))
                places.append(cv2.perspectiveTransform(corners[None], matrix)[0])
                others += anchor != frame
        if others:
            found[frame] = _by_corners(np.average(places, axis=0, weights=weights), pairs.size)
    return found


def _completed(
    found: dict[int, Matrix], wanted: npt.NDArray[np.int64], size: tuple[int, int]
) -> tuple[Matrix, npt.NDArray[np.bool_]]:
    """[M, 3, 3] of the `wanted` frames, where none was found by interpolated corners, and whether one was, [M]."""
    known = np.array([int(frame) in found for frame in wanted], bool)
    if not found:
        return np.tile(np.eye(3), (len(wanted), 1, 1)), known
    numbers = sorted(found)
    places = np.stack([cv2.perspectiveTransform(_corners(size)[None], found[number])[0] for number in numbers])
    between = [np.interp(wanted, numbers, places[:, corner, axis]) for corner in range(4) for axis in range(2)]
    filled = np.stack(between, axis=1).reshape(-1, 4, 2)
    matrices = [
        found[int(frame)] if int(frame) in found else _by_corners(corners, size)
        for frame, corners in zip(wanted, filled, strict=True)
    ]
    return np.stack(matrices), known


def _corners(size: tuple[int, int]) -> npt.NDArray[np.float64]:
    height, width = size
    return np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float64) - 0.5


def _by_corners(places: npt.NDArray[np.float64], size: tuple[int, int]) -> Matrix:
    """The homography that takes the frame's corners to `places` [4, 2]."""
    matrix = cv2.getPerspectiveTransform(_corners(size).astype(np.float32), places.astype(np.float32))
    return np.asarray(matrix, np.float64)
